"""First cameras of any model; of a wide lens the one under which boards look flat and square."""

import numpy as np

from jaxscan.calibration.seed.closed_form import MIN_SHARE, centred_corners, check_tilts, pose_from_rays, seed_narrow
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.errors import CalibrationError
from jaxscan.geometry import CAMERAS, AbstractCamera, CameraModel


# Field of view of the farthest corner, from the axis [rad]: from a mild lens to one that sees far
# behind itself.
_WIDEST, _NARROWEST = np.radians(130.0), np.radians(15.0)
_FOCAL_STEPS = 16
_REFINEMENTS = 10
# The cubic term of real lenses, from the orthographic (-1/6) to the stereographic (1/12) and a little beyond.
_CUBIC = (-0.12, -0.06, 0.0, 0.06)
_CUBIC_RANGE = (-0.18, 0.12)
# As many views as this, spread over all, tell the focal length well enough for a start.
_SEARCH_VIEWS = 9
# Misfit of a lens with one coefficient [share of the image's radius]: for real lenses below 0.02.
_MAX_MISFIT = 0.1


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


def seed_wide(data: Prepared) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Focal length, cubic distortion and board poses, also of boards beyond 90 degrees.

    A trial lens $\theta_d = \theta (1 + k_1 \theta^2)$ makes rays of the corners; seen along the
    middle ray of their view, those of a flat board are a homography of it, whatever the angle to
    the optical axis. The lens that leaves the smallest distances in the image is taken. Square
    pixels and a centred principal point are assumed; the solve frees both.

    Returns:
        theta: Angles of the corners to the optical axis [n], rad.
        radius: Distances from the middle of the image at which the lens shows them [n], px.
        poses: T_cam_board of every view [views, 4, 4] (identity where not usable).

    Raises:
        CalibrationError: If the views do not determine a camera.
    """
    views, corners = centred_corners(data)
    chosen = np.unique(np.linspace(0, len(views) - 1, _SEARCH_VIEWS).round().astype(int))
    focal, cubic = _search([corners[index] for index in chosen])
    poses = np.tile(np.eye(4), (len(data.usable), 1, 1))
    for view, (points, q) in zip(views, corners, strict=True):
        poses[view] = _board_pose(points, q, focal, cubic)[0]
    check_tilts(poses[views])
    rays, exists = _rays(np.concatenate([q for _, q in corners]), focal, cubic)
    theta = np.arccos(rays[exists, 2])
    return theta, focal * theta * (1.0 + cubic * theta * theta), poses


def _board_pose(points: np.ndarray, q: np.ndarray, focal: float, cubic: float) -> tuple[np.ndarray, float]:
    """T_cam_board [4, 4] of board points [n, 2] seen at pixels [n, 2] about the principal point.

    Returns:
        The pose, and the share of the corners that are rays of such a lens on one side of the camera;
        where they are too few, that of any board where they are.
    """
    rays, exists = _rays(q, focal, cubic)
    pose, share = pose_from_rays(points[exists], rays[exists])
    return pose, share * float(exists.mean())


def _search(seen: list[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float]:
    """Focal length [px/rad] and k1 with the smallest misfit."""
    radius = max(float(np.hypot(*q.T).max()) for _, q in seen)
    grid = np.log(radius / np.geomspace(_WIDEST, _NARROWEST, _FOCAL_STEPS))
    step = grid[1] - grid[0]
    misfit = lambda log_focal, cubic: _misfit(seen, float(np.exp(log_focal)), cubic)
    coarse = np.array([[misfit(focal, cubic) for focal in grid] for cubic in _CUBIC])
    row, column = np.unravel_index(np.argmin(coarse), coarse.shape)
    focal, cubic, best = grid[column], _CUBIC[row], coarse[row, column]
    if not best < _MAX_MISFIT * radius:
        raise CalibrationError(
            "No wide-angle lens makes the corners found those of a flat board: check `[board]` in capture.toml (type, "
            "columns, rows), and that the images are neither cropped nor rectified."
        )
    step_cubic = _CUBIC[1] - _CUBIC[0]
    # Focal length and cubic term nearly make up for each other, so steps along both at once too.
    for _ in range(_REFINEMENTS):
        trials = [
            (focal + a * step, float(np.clip(cubic + b * step_cubic, *_CUBIC_RANGE)))
            for a in (-1, 0, 1)
            for b in (-1, 0, 1)
            if a or b
        ]
        values = [misfit(*trial) for trial in trials]
        if min(values) < best:
            best = min(values)
            focal, cubic = trials[int(np.argmin(values))]
        else:
            step, step_cubic = step / 2, step_cubic / 2
    return float(np.exp(focal)), float(cubic)


def _misfit(seen: list[tuple[np.ndarray, np.ndarray]], focal: float, cubic: float) -> float:
    """Mean over the views of the median distance of the corners from their board [px]."""
    distances = []
    for points, q in seen:
        pose, share = _board_pose(points, q, focal, cubic)
        if share < MIN_SHARE:
            return np.inf
        p = np.column_stack([points, np.zeros(len(points))]) @ pose[:3, :3].T + pose[:3, 3]
        radius = np.hypot(p[:, 0], p[:, 1])
        theta = np.arctan2(radius, p[:, 2])
        scale = focal * theta * (1.0 + cubic * theta * theta) / np.maximum(radius, 1e-12)
        distances.append(float(np.median(np.hypot(*(scale[:, None] * p[:, :2] - q).T))))
    return float(np.mean(distances))


def _rays(q: np.ndarray, focal: float, cubic: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays [n, 3] of pixels about the principal point, and which exist."""
    radius = np.hypot(*q.T)
    # theta (1 + k1 theta^2) grows up to here. The table is linear to 1e-6 between its points.
    last = np.pi if cubic >= 0 else min(np.pi, 1.0 / np.sqrt(-3.0 * cubic))
    table = np.linspace(0.0, last, 1000)
    grown = focal * table * (1.0 + cubic * table * table)
    theta = np.interp(radius, grown, table)
    aside = np.sin(theta) / np.maximum(radius, 1e-12)
    return np.column_stack([aside[:, None] * q, np.cos(theta)]), radius < grown[-1]
