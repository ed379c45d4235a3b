"""A calibration in one number: pixels of ray for its camera, millimetres at a working distance for its rig."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.verdict import limits
from jaxscan.calibration.verdict.lengths import point_error, working_depth
from jaxscan.calibration.verdict.quality import GoodTo, ModelTest
from jaxscan.geometry import AbstractCamera, Scanner


# Places of the image at which rays are compared, columns and rows.
_GRID = (16, 12)
# Length of the steps of differences, in units of the errors of first values: the next order is a millionth.
_STEP = 1e-3
# A lens model that does not come back to a pixel does not reach it.
_RETURNS_PX = 1e-2


def measure_good_to(
    camera: AbstractCamera,
    scanner: Scanner | None,
    statistical: Float[np.ndarray, "steps params"],
    structure: Sequence[tuple[ModelTest, np.ndarray]],
    at_m: float | None,
) -> tuple[GoodTo, tuple[ModelTest, ...]]:
    """The error of rays and of scanned points, and the part of each cause.

    Args:
        camera: The calibrated camera, with its size.
        scanner: The calibrated rig; None of a camera alone.
        statistical: Steps of noise, in the minimal coordinates of the rig, those of the camera first.
        structure: The tests, each with the steps of its structure, none where there is none.
        at_m: Depth of the points [m]; None: as people judge such a rig.

    Returns:
        The errors, and the tests with their parts of them.
    """
    groups = [statistical, *(steps for _, steps in structure)]
    by_camera = ray_slopes(camera)
    px = [
        float(np.sqrt(np.mean(np.sum((by_camera @ steps[:, : by_camera.shape[-1]].T) ** 2, (1, 2)))))
        for steps in groups
    ]
    mm, depth = _at_work(scanner, groups, at_m)
    tests = [
        replace(test, effect_px=px[index], effect_mm=mm[index] if mm else None) if len(steps) else test
        for index, (test, steps) in enumerate(structure, 1)
    ]
    whole = lambda parts: float(np.linalg.norm(parts)) if parts else None
    return GoodTo(whole(mm), mm[0] if mm else None, depth, whole(px), px[0]), tuple(tests)


def focal_share(camera: AbstractCamera, steps: Float[np.ndarray, "steps params"]) -> float:
    """Standard deviation of the focal length over it [1]: of the scale in the middle of the image, of any model.

    Args:
        camera: The calibrated camera.
        steps: In the minimal coordinates, those of the camera first; each counts as one standard deviation.
    """
    own = steps[:, : len(camera.parameter_names())]
    scale = lambda step: float(np.trace(np.asarray(camera.retract(step).slopes(np.array([0.0, 0.0, 1.0])))[:, :2]))
    changes = [scale(_STEP * step) - scale(-_STEP * step) for step in own]
    return float(np.linalg.norm(changes)) / (2.0 * _STEP * scale(np.zeros(own.shape[1])))


def refusal(
    good_to: GoodTo,
    camera: AbstractCamera,
    settings: CalibrationSettings,
    *,
    has_sheets: bool = True,
    focal: float = 0.0,
) -> str | None:
    """Why a calibration cannot be used, its focal length known to a share of it; None where it can."""
    mm, px, at_m = good_to.sigma_mm, good_to.sigma_px, good_to.at_m
    if mm is None and settings.limit_mm is not None:
        if not has_sheets:
            return f"{settings.limit_mm:g} mm were asked, and without a laser sheet there are no points"
        where = "within reach" if settings.at_m is None else f"in the image at {settings.at_m:g} m"
        return f"{settings.limit_mm:g} mm were asked, and no stripe is {where}"
    if mm is not None and settings.limit_mm is not None and mm > settings.limit_mm:
        return f"{settings.limit_mm:g} mm were asked"
    if px is not None and settings.limit_px is not None and px > settings.limit_px:
        return f"{settings.limit_px:g} px were asked, and its rays are good to {px:.2g} px"
    if focal > limits.UNKNOWN_FOCAL:
        return (
            f"its focal length is known to {100 * focal:.2g} % only, which makes no camera: tilt the board by 20 to "
            "45 degrees in different directions"
        )
    share = f"{100 * limits.USELESS_SHARE:.0f} %"
    if mm is not None and at_m is not None and mm > 1e3 * limits.USELESS_SHARE * at_m:
        return f"points that are off by more than {share} of their distance are of no use"
    if px is not None and px > limits.USELESS_SHARE * 0.5 * (float(camera.fx) + float(camera.fy)):
        return f"rays that are off by more than {share} of the focal length are of no use"
    return None


def ray_slopes(camera: AbstractCamera) -> Float[np.ndarray, "places 2 params"]:
    """Motion of the image by the camera's parameters at places all over it, after the best rotation [px]."""
    q = image_places(camera)
    ray = np.asarray(camera.unproject(q))
    back = np.asarray(camera.project(ray))
    turns = np.asarray(camera.slopes(ray)) @ np.stack([np.cross(axis, ray) for axis in np.eye(3)], -1)
    count = len(camera.parameter_names())
    sizes = _STEP * np.array([block.scale for block in camera.blocks() for _ in block.parameters][:count])
    moved = lambda step: np.asarray(camera.retract(step).project(ray))
    slopes = np.stack([moved(step) - moved(-step) for step in np.diag(sizes)], -1) / (2.0 * sizes)
    reached = np.linalg.norm(back - q, axis=1) < _RETURNS_PX
    reached &= np.isfinite(slopes).all((1, 2)) & np.isfinite(turns).all((1, 2))
    slopes, turns = slopes[reached].reshape(-1, slopes.shape[-1]), turns[reached].reshape(-1, 3)
    taken, _, _, _ = np.linalg.lstsq(turns, slopes, rcond=None)
    return (slopes - turns @ taken).reshape(-1, 2, slopes.shape[-1])


def image_places(camera: AbstractCamera) -> Float[np.ndarray, "places 2"]:
    """Pixels all over the image."""
    u, v = (
        (np.arange(count) + 0.5) / count * size - 0.5
        for count, size in zip(_GRID, (camera.width, camera.height), strict=True)
    )
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _at_work(
    scanner: Scanner | None, groups: Sequence[np.ndarray], at_m: float | None
) -> tuple[list[float], float | None]:
    """Errors of scanned points for each group of steps [mm], of the laser that is worst, and their depth [m]."""
    if scanner is None:
        return [], None
    worst: list[float] = []
    worst_depth = None
    for laser in range(len(scanner.laser_names)):
        depth = working_depth(scanner, laser) if at_m is None else at_m
        found = [] if depth is None else [point_error(scanner, laser, depth, steps) for steps in groups]
        known = [value for value in found if value is not None]
        if known and len(known) == len(groups) and np.linalg.norm(known) > np.linalg.norm(worst):
            worst, worst_depth = known, depth
    return worst, worst_depth
