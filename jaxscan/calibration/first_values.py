"""First values of camera, board poses, laser planes, motion and placements, in closed form or by a coarse search."""

import itertools
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration.problem import Prepared
from jaxscan.errors import CalibrationError
from jaxscan.geometry import (
    CAMERAS,
    MOTIONS,
    AbstractCamera,
    AbstractMotion,
    CameraModel,
    LaserSheet,
    apply_homography,
    carrying,
    compose,
    direct_homography,
    fit_plane,
    invert,
    motion_class,
    nearest_rotation,
    point_up,
)
from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.observation import Observations


# A board is looked at along its middle ray: beyond this cosine of the angle from it, tangents mean nothing.
_MIN_COSINE = 0.1
# Share of a view's corners that must be rays on one side of the camera: the rest may be wrong.
_MIN_SHARE = 0.9
# Boards whose normals differ by less show the camera one vanishing line: focal length and
# principal point cannot be told apart. The second is the tilt that users are asked for.
_MIN_TILT_DEG, _TILTED_DEG = 5.0, 20.0
# Stripe points reaching less far across than this share of their length are one line.
_MIN_PLANE_SPREAD = 0.02


def seed_camera(data: Prepared, model: CameraModel) -> tuple[list[AbstractCamera], np.ndarray]:
    """First cameras, with square pixels and the principal point in the middle, and first board poses.

    Returns:
        One camera or several to try, with all coefficients that the model knows, and T_cam_board of
        every view [views, 4, 4] (identity where it fixes no pose).

    Raises:
        CalibrationError: If the views do not determine a camera.
    """
    kind, views = CAMERAS[model], np.flatnonzero(data.fixes_pose)
    if len(views) == 0:
        raise CalibrationError(
            "The board was not found in any view: "
            "check `[board]` in capture.toml (type, columns, rows) and the exposure."
        )
    if len(views) < 3:
        raise CalibrationError(
            f"The board was found in {len(views)} view(s) and a camera needs at least 3: "
            "capture 10 or more, tilted by 20 to 45 degrees in different directions."
        )
    centre = (np.array(data.size) - 1) / 2
    seen = _Corners(data.board[:, :2], data.corner_q[views] - centre, data.corner_valid[views])
    poses = np.tile(np.eye(4), (len(data.fixes_pose), 1, 1))
    theta, radius, poses[views] = _seed_wide(seen) if kind.wide else _seed_narrow(seen, max(data.size))
    cameras = [
        kind(values[0], values[0], centre[0], centre[1], values[1:], *data.size)
        for values in kind.fit_curve(theta, radius)
    ]
    return cameras, poses


class _Corners(NamedTuple):
    """Corners of the views that fix a pose."""

    points: np.ndarray
    """Corners on the flat board [corners, 2], m."""
    q: np.ndarray
    """Seen corners, counted from the middle of the image [views, corners, 2], px."""
    valid: np.ndarray
    """[views, corners]."""


def _seed_narrow(seen: _Corners, longest: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The lens and the board poses from homographies, without distortion.

    Source: Zhang, A flexible new technique for camera calibration (2000), section 3.1.
    """
    homographies = _fit_homographies(seen.points, seen.q, seen.valid)
    found = _focal_length(homographies)
    # Even with a wrong focal length the normals show whether the boards are tilted.
    focal = found or 1.2 * longest
    poses = _poses_from_homographies(homographies, focal)
    check_tilts(poses, determined=found is not None)
    radius = np.hypot(*seen.q[seen.valid].T)
    return np.arctan2(radius, focal), radius, poses


def check_tilts(poses: np.ndarray, *, determined: bool = True) -> None:
    """See that boards at T_cam_board [views, 4, 4] are tilted differently.

    Raises:
        CalibrationError: If they are not, or the focal length was not `determined`.
    """
    normals = poses[:, :3, 2]
    tilt = np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0))).max()
    if not determined and tilt >= _TILTED_DEG:
        raise CalibrationError(
            f"No focal length explains all {len(poses)} views, whose tilts differ by up to {tilt:.0f} degrees: give a "
            "known camera, or capture more views, with the board tilted by 20 to 45 degrees in different directions."
        )
    if not determined or tilt < _MIN_TILT_DEG:
        raise CalibrationError(
            f"All {len(poses)} views show the board at the same tilt (within {tilt:.1f} degrees), which determines no "
            "camera: tilt the board by 20 to 45 degrees in different directions."
        )


def seed_plane(points: np.ndarray, name: str) -> LaserSheet:
    """The laser plane through stripe points lifted to their boards [n, 3].

    Raises:
        CalibrationError: If there are no points, or they all lie on one line.

    Source: the paper, equation (8), as total least squares.
    """
    if len(points) < 10:
        raise CalibrationError(
            f"No stripe of laser {name!r} was seen on the board, so its plane cannot be determined: "
            "capture each board pose with the laser on and off."
        )
    for _ in range(5):
        plane = fit_plane(points)
        distance = np.abs(points @ plane.normal - plane.distance)
        keep = distance <= 3.5 * MEDIAN_TO_SIGMA * np.median(distance) + 1e-9
        if keep.all():
            break
        points = points[keep]
    plane = fit_plane(points)
    if plane.spread[1] < _MIN_PLANE_SPREAD * plane.spread[0]:
        raise CalibrationError(
            f"All stripes of laser {name!r} lie on one line in space, so its plane cannot be determined: "
            "capture the stripe on board poses at different distances or tilts."
        )
    if plane.distance <= 0:
        raise CalibrationError(f"The plane of laser {name!r} contains the camera centre: it shows no depth.")
    return LaserSheet.from_plane(plane.normal, plane.distance)


def _fit_homographies(points: np.ndarray, q: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Homographies [views, 3, 3] from board points [n, 2] to pixels [views, n, 2], robust against a few wrong corners.

    Source: Hartley and Zisserman, Multiple View Geometry, normalised direct linear transformation.
    """
    keep, least = valid, np.maximum(6, valid.sum(1) // 2)[:, None]
    for _ in range(3):
        homographies = direct_homography(points, q, keep)
        distance = np.linalg.norm(apply_homography(homographies, points) - q, axis=-1)
        # Lens distortion is no error here, so only corners far beyond the usual misfit are dropped.
        trimmed = valid & (distance <= 6.0 * _median(distance, valid)[:, None] + 1e-9)
        trimmed = np.where(trimmed.sum(1, keepdims=True) >= least, trimmed, keep)
        if np.array_equal(trimmed, keep):
            break
        keep = trimmed
    return homographies


def _median(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Median of the valid values of each row; 0 where there are none."""
    return np.array([np.median(row[there]) if there.any() else 0.0 for row, there in zip(values, valid, strict=True)])


def _poses_from_homographies(homographies: np.ndarray, focal: float) -> np.ndarray:
    """T_cam_board [views, 4, 4] from homographies to pixels about the principal point."""
    columns = homographies / np.array([[focal], [focal], [1.0]])
    length = np.linalg.norm(columns[:, :, :2], axis=1).sum(1)
    columns = columns * (np.where(columns[:, 2, 2] >= 0, 2.0, -2.0) / length)[:, None, None]
    poses = np.tile(np.eye(4), (len(columns), 1, 1))
    across = np.cross(columns[:, :, 0], columns[:, :, 1])
    poses[:, :3, :3] = nearest_rotation(np.stack([columns[:, :, 0], columns[:, :, 1], across], axis=-1))
    poses[:, :3, 3] = columns[:, :, 2]
    return poses


def _focal_length(homographies: np.ndarray) -> float | None:
    # The columns are images of perpendicular vectors of equal length.
    x, y = homographies[:, :, 0], homographies[:, :, 1]
    dot = lambda one, other: np.sum(one[:, :2] * other[:, :2], axis=1)
    size = np.maximum(np.sqrt(dot(x, x) * dot(y, y)), 1e-300)
    a = np.concatenate([dot(x, y) / size, (dot(x, x) - dot(y, y)) / size])
    b = np.concatenate([-x[:, 2] * y[:, 2] / size, (y[:, 2] ** 2 - x[:, 2] ** 2) / size])
    inverse_square = float(a @ b / max(a @ a, 1e-300))
    return float(1.0 / np.sqrt(inverse_square)) if inverse_square > 0 else None


def seed_poses(data: Prepared, camera: AbstractCamera) -> np.ndarray:
    """T_cam_board of every view [views, 4, 4], identity where not usable.

    Seen along the middle ray of its view, a flat board is a homography, whatever its angle to the optical axis.

    Raises:
        CalibrationError: If no view shows the board where this camera has rays.
    """
    poses, views = np.tile(np.eye(4), (len(data.fixes_pose), 1, 1)), np.flatnonzero(data.fixes_pose)
    rays = np.asarray(jax.tree.map(np.asarray, camera).unproject(data.corner_q[views]))
    poses[views], share = _poses_from_rays(data.board[:, :2], rays, data.corner_valid[views])
    if not (share >= _MIN_SHARE).any():
        raise CalibrationError(
            "The known camera sees the board in no view: check that it is the calibration of this camera, or calibrate "
            "the camera too."
        )
    return poses


def _poses_from_rays(points: np.ndarray, rays: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T_cam_board [views, 4, 4] of board points [n, 2] along unit rays [views, n, 3], and the share of rays used."""
    count = np.maximum(valid.sum(1), 1)
    mean = np.sum(np.where(valid[..., None], rays, 0.0), axis=1) / count[:, None]
    # A rotation that turns the middle ray to +z.
    z = np.where(valid.sum(1, keepdims=True) > 0, mean, [0.0, 0.0, 1.0])
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z), axis=1)], z)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    towards = np.stack([x, np.cross(z, x), z], axis=1)
    turned = rays @ np.swapaxes(towards, 1, 2)
    ahead = np.asarray(valid & (turned[..., 2] > _MIN_COSINE))
    share = ahead.sum(1) / count
    poses, back = np.tile(np.eye(4), (2, len(rays), 1, 1))
    poses[:, 2, 3], back[:, :3, :3] = 1.0, np.swapaxes(towards, 1, 2)
    good = np.asarray(share >= _MIN_SHARE)
    if good.any():
        flat = turned[good, :, :2] / np.where(ahead[good], turned[good, :, 2], 1.0)[..., None]
        poses[good] = _poses_from_homographies(_fit_homographies(points, flat, ahead[good]), 1.0)
    return back @ poses, share


# Field of view of the farthest corner, from the axis [rad]: from a mild lens to one that sees far
# behind itself.
_WIDEST, _NARROWEST = np.radians(130.0), np.radians(15.0)
_FOCAL_STEPS = 16
_REFINEMENTS = 10
# The cubic term of real lenses, from the orthographic (-1/6) to the stereographic (1/12) and a little beyond.
_CUBIC = (-0.12, -0.06, 0.0, 0.06)
_CUBIC_RANGE = (-0.18, 0.12)
# This many views, evenly chosen from all, show the focal length well enough for a start.
_SEARCH_VIEWS = 9
# Misfit of a lens with one coefficient [share of the image's radius]: for real lenses below 0.02.
_MAX_MISFIT = 0.1


def _seed_wide(seen: _Corners) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Focal length, cubic distortion and board poses, also of boards beyond 90 degrees.

    A trial lens $\theta_d = \theta (1 + k_1 \theta^2)$ makes rays of the corners; seen along the
    middle ray of their view, those of a flat board are a homography of it, whatever the angle to
    the optical axis. The lens that leaves the smallest distances in the image is taken. Square
    pixels and a centred principal point are assumed; the solve frees both.
    """
    chosen = np.unique(np.linspace(0, len(seen.q) - 1, _SEARCH_VIEWS).round().astype(int))
    focal, cubic = _search(_Corners(seen.points, seen.q[chosen], seen.valid[chosen]))
    poses, _ = _board_poses(seen, focal, cubic)
    check_tilts(poses)
    rays, exists = _rays(seen.q[seen.valid], focal, cubic)
    theta = np.arccos(rays[exists, 2])
    return theta, focal * theta * (1.0 + cubic * theta * theta), poses


def _board_poses(seen: _Corners, focal: float, cubic: float) -> tuple[np.ndarray, np.ndarray]:
    """T_cam_board of the views, and the shares of their corners that are rays of such a lens on one side of it."""
    rays, exists = _rays(seen.q, focal, cubic)
    there = seen.valid & exists
    poses, share = _poses_from_rays(seen.points, rays, there)
    return poses, share * there.sum(1) / seen.valid.sum(1)


def _search(seen: _Corners) -> tuple[float, float]:
    """Focal length [px/rad] and k1 with the smallest misfit."""
    radius = float(np.linalg.norm(seen.q[seen.valid], axis=-1).max())
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


def _misfit(seen: _Corners, focal: float, cubic: float) -> float:
    """Mean over the views of the median distance of the corners from their board [px]."""
    poses, share = _board_poses(seen, focal, cubic)
    if (share < _MIN_SHARE).any():
        return np.inf
    p = seen.points @ np.swapaxes(poses[:, :3, :2], 1, 2) + poses[:, None, :3, 3]
    radius = np.hypot(p[..., 0], p[..., 1])
    theta = np.arctan2(radius, p[..., 2])
    scale = focal * theta * (1.0 + cubic * theta * theta) / np.maximum(radius, 1e-12)
    distance = np.linalg.norm(scale[..., None] * p[..., :2] - seen.q, axis=-1)
    return float(np.mean(_median(distance, seen.valid)))


def _rays(q: np.ndarray, focal: float, cubic: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays [..., 3] of pixels about the principal point, and which exist."""
    radius = np.linalg.norm(q, axis=-1)
    # theta (1 + k1 theta^2) grows up to here. The table is linear to 1e-6 between its points.
    last = np.pi if cubic >= 0 else min(np.pi, 1.0 / np.sqrt(-3.0 * cubic))
    table = np.linspace(0.0, last, 1000)
    grown = focal * table * (1.0 + cubic * table * table)
    theta = np.interp(radius, grown, table)
    aside = np.sin(theta) / np.maximum(radius, 1e-12)
    return np.concatenate([aside[..., None] * q, np.cos(theta)[..., None]], axis=-1), radius < grown[-1]


def seed_motion(poses: np.ndarray, data: Prepared, observations: Observations) -> AbstractMotion:
    """The motion from placements seen at several positions.

    Raises:
        CalibrationError: If no placement was seen from two positions, or the boards did not move like that.
    """
    carries, given_poses = observations.carries, observations.poses
    kind, pairs = MOTIONS[carries], list[tuple[int, int]]()
    for number in np.unique(data.placement[data.fixes_pose]):
        views = np.flatnonzero(data.fixes_pose & (data.placement == number)).tolist()
        pairs += [p for p in itertools.combinations(views, 2) if abs(data.angle[p[0]] - data.angle[p[1]]) > kind.least]
    if not pairs:
        raise CalibrationError(
            f"No board placement was seen from two {kind.stops}, so the {kind.part} cannot be determined: "
            f"{kind.capture}."
        )
    first, second = np.array(pairs).T
    change = data.angle[second] - data.angle[first]
    if given_poses is not None:
        given = np.asarray(given_poses, np.float64)[np.round(data.angle).astype(int)]
        change = np.asarray(compose(invert(given[first]), given[second]))
    try:
        motion = motion_class(carries).of_boards(poses[np.array(pairs).T], change)
    except ValueError as problem:
        raise CalibrationError(str(problem)) from problem
    return point_up(carrying(motion, carries), observations.up)


def average_placements(poses: np.ndarray, data: Prepared, motion: AbstractMotion) -> np.ndarray:
    """T_cam0_board of every placement [views, 4, 4] (as many as views; the rest is identity)."""
    motions = np.asarray(jax.tree.map(np.asarray, motion).motion(data.angle))
    result = np.tile(np.eye(4), (len(data.fixes_pose), 1, 1))
    for number in np.unique(data.placement[data.fixes_pose]):
        views = np.flatnonzero(data.fixes_pose & (data.placement == number))
        still = motions[views] @ poses[views]
        result[number, :3, :3] = nearest_rotation(still[:, :3, :3].mean(0))
        result[number, :3, 3] = np.median(still[:, :3, 3], axis=0)
    return result
