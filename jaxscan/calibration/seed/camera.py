"""First cameras of any model."""

import numpy as np

from jaxscan.calibration.seed.closed_form import seed_narrow
from jaxscan.calibration.seed.wide import seed_wide
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.geometry import CAMERAS, AbstractCamera, CameraModel


def seed_camera(data: Prepared, model: CameraModel) -> tuple[list[AbstractCamera], np.ndarray]:
    """First cameras, with square pixels and the principal point in the middle, and first board poses.

    Returns:
        One camera or several to try, with all coefficients that the model knows, and T_cam_board of
        every view [views, 4, 4] (identity where not usable).

    Raises:
        CalibrationError: If the views do not determine a camera.
    """
    kind = CAMERAS[model]
    theta, radius, poses = seed_wide(data) if kind.wide else seed_narrow(data)
    centre = (np.array(data.size) - 1) / 2
    cameras = [
        kind(values[0], values[0], centre[0], centre[1], values[1:], *data.size)
        for values in kind.fit_curve(theta, radius)
    ]
    return cameras, poses
