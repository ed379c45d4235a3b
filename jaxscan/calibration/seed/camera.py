"""A first camera of any model."""

import numpy as np

from jaxscan.calibration.seed.closed_form import seed_narrow
from jaxscan.calibration.seed.wide import seed_wide
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.geometry import CAMERAS, AbstractCamera, CameraModel


def seed_camera(data: Prepared, model: CameraModel) -> tuple[AbstractCamera, np.ndarray]:
    """A first camera, square pixels and its principal point in the middle, and first board poses.

    Returns:
        The camera, with all coefficients that its model knows, and T_cam_board of every view
        [views, 4, 4] (identity where not usable).

    Raises:
        CalibrationError: If the views do not determine a camera.
    """
    kind = CAMERAS[model]
    theta, radius, poses = seed_wide(data) if kind.wide else seed_narrow(data)
    focal, *lens = kind.fit_curve(theta, radius)
    centre = (np.array(data.size) - 1) / 2
    return kind(np.asarray(focal), np.asarray(focal), centre[0], centre[1], np.array(lens), *data.size), poses
