"""Observations to a calibration: seed, joint solve, covariance, and numbers to judge it by."""

import time
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxscan.calibration.adjust import Adjustment, adjust, prior_weights
from jaxscan.calibration.covariance import Determination, determine
from jaxscan.calibration.observations import Observations
from jaxscan.calibration.parameters import ANGLE_PARAMETERS, parameter_scales, shared_names
from jaxscan.calibration.prepare import Prepared, prepare
from jaxscan.calibration.residuals import Problem, camera_from_board, prior_names
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.seed import average_placements, lift_stripes, seed_axis, seed_camera, seed_plane
from jaxscan.calibration.settings import CAMERA_BLOCKS, Block, CalibrationSettings
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array, LaserSheet, Scanner, Turntable, point_up, stack_lasers
from jaxscan.geometry.scanner import UP_VECTORS
from jaxscan.geometry.turntable import Carries


# More than this is worth a word in the report: the priors should only hold what nothing else does.
_PRIOR_COST_WARNING = 0.01
_REJECTED_WARNING = 0.03


def calibrate_observations(observations: Observations, *, settings: CalibrationSettings | None = None) -> Calibration:
    """Camera, laser sheets and axis in one least-squares problem, with their covariance.

    Closed-form first values; then a robust joint solve, rejection of outliers, estimation of the
    noise of corners and stripes, and a last plain solve. Runs in float64 whatever the caller's
    JAX settings.

    Args:
        observations: Board corners, stripes on boards, table angles.
        settings: What is free, priors, thresholds.

    Returns:
        The calibration; `quality` holds, in px unless named otherwise: `corner_rms_px` (root mean
        square corner distance of the corners in the solve, as `cv2.calibrateCamera` counts it) and
        `corner_rms_all_px` (with the rejected ones), `stripe_rms_px`, whitened
        RMS per group, estimated noise over given sigma, counts, rejected shares, `per_view`,
        `condition`, `unobserved`, `prior_share`, `board_warp_m`, `steps`, `seconds`, `warnings`.

    Raises:
        CalibrationError: If the observations do not determine the scanner; it says what to capture.

    Source: PAPER.md equations (1)-(12), solved together.
    """
    settings = settings or CalibrationSettings()
    started = time.perf_counter()
    with jax.enable_x64(True):
        data = prepare(observations)
        first, poses = _camera_stage(observations, data, settings)
        camera = _named(first.scanner, observations, None).camera
        lasers = [
            seed_plane(lift_stripes(data, camera, poses, index), name)
            for index, name in enumerate(observations.laser_names)
        ]
        table = seed_axis(poses, data, observations.carries, observations.up)
        scanner = Scanner(camera, stack_lasers(lasers), table, laser_names=observations.laser_names, up=observations.up)
        placements = average_placements(poses, data, table)
        problem = _problem(scanner, placements, first.warp, data, settings.free, settings)
        result = _pointed_up(adjust(problem, data, settings), observations, data, settings)
        return _calibration(result, observations, data, settings, started)


def calibrate_camera(observations: Observations, *, settings: CalibrationSettings | None = None) -> Calibration:
    """The camera alone, from boards in any poses; stripes, angles and placements are not used.

    Args:
        observations: Board corners.
        settings: As for `calibrate_observations`.

    Returns:
        A calibration without a scanner; `order` and `covariance` are the camera's.

    Raises:
        CalibrationError: If the views do not determine a camera.

    Source: PAPER.md equations (1), (2), (4), after Zhang.
    """
    settings = settings or CalibrationSettings()
    started = time.perf_counter()
    with jax.enable_x64(True):
        data = _camera_data(prepare(observations))
        camera, poses = seed_camera(data, observations.width, observations.height, _coefficients(settings))
        free = tuple(block for block in settings.free if block in (*CAMERA_BLOCKS, "warp"))
        problem = _problem(_stand_in(camera, observations), poses, np.zeros(2), data, free, settings)
        result = adjust(problem, data, settings)
        return _calibration(result, observations, data, replace(settings, free=free), started, camera_only=True)


def _camera_stage(
    observations: Observations, data: Prepared, settings: CalibrationSettings
) -> tuple[Problem, np.ndarray]:
    """Camera and T_cam_board of every view, each view by itself and without stripes."""
    camera_data = _camera_data(data)
    camera, poses = seed_camera(camera_data, observations.width, observations.height, _coefficients(settings))
    free = tuple(block for block in settings.free if block in CAMERA_BLOCKS)
    start = _problem(_stand_in(camera, observations), poses, np.zeros(2), camera_data, free, settings)
    result = adjust(start, camera_data, settings, rejection=False)
    return result.problem, np.asarray(result.problem.poses)


def _camera_data(data: Prepared) -> Prepared:
    # Every view is a placement of its own, so a board that was moved by mistake does no harm.
    return data._replace(
        placement=np.where(data.usable, np.arange(len(data.usable)), 0).astype(np.int32),
        angle=np.zeros_like(data.angle),
        stripe_valid=np.zeros_like(data.stripe_valid),
    )


def _stand_in(camera: Any, observations: Observations) -> Scanner:
    """A scanner round a camera; what is not the camera is held and meets no observation."""
    sheet = LaserSheet.from_plane(np.array([1.0, 0.0, 0.0]), 1.0)
    table = Turntable.from_axis(
        np.array(UP_VECTORS[observations.up]), np.array([0.0, 0.0, -0.1]), carries=observations.carries
    )
    names = observations.laser_names or ("laser",)
    return Scanner(camera, stack_lasers([sheet] * len(names)), table, laser_names=names, up=observations.up)


def _coefficients(settings: CalibrationSettings) -> int:
    return 8 if "rational" in settings.free else 5


def _problem(
    scanner: Scanner,
    poses: np.ndarray,
    warp: Array,
    data: Prepared,
    free: tuple[Block, ...],
    settings: CalibrationSettings,
) -> Problem:
    names, lasers = shared_names(scanner), len(scanner.laser_names)
    camera = scanner.camera
    xy = data.board[:, :2]
    half = np.maximum(np.ptp(xy, axis=0) / 2, 1e-12)
    return Problem(
        scanner=_anonymous(scanner),
        poses=poses,
        warp=np.asarray(warp),
        scales=parameter_scales(names, free),
        board=data.board,
        frame=np.concatenate([(xy.min(0) + xy.max(0)) / 2, half]),
        centre=np.array([(camera.width - 1) / 2, (camera.height - 1) / 2]),
        corner_q=data.corner_q,
        corner_weight=np.zeros(data.corner_valid.shape),
        angle=data.angle,
        placement=data.placement,
        stripe_q=data.stripe_q,
        stripe_weight=np.zeros(data.stripe_valid.shape),
        stripe_view=data.stripe_view,
        stripe_laser=data.stripe_laser,
        prior_weight=prior_weights(names, lasers, free, settings),
    )


def _anonymous(scanner: Scanner) -> Scanner:
    """As the solver sees it: without names and sizes, and with a table that carries the scanner.

    The solver needs none of these, and would compile again for each.
    """
    names = tuple(str(index) for index in range(len(scanner.laser_names)))
    camera = replace(scanner.camera, width=0, height=0)
    return Scanner(camera, scanner.lasers, _carrying(scanner.turntable, "scanner"), laser_names=names)


def _named(scanner: Scanner, observations: Observations, covariance: np.ndarray | None) -> Scanner:
    """The inverse of `_anonymous`."""
    camera = replace(scanner.camera, width=observations.width, height=observations.height)
    names = observations.laser_names or ("laser",)
    table = _carrying(scanner.turntable, observations.carries)
    return Scanner(camera, scanner.lasers, table, covariance, names, observations.up)


def _carrying(table: Turntable, carries: Carries) -> Turntable:
    """The same motion of boards in front of the camera: what turns backwards, turns the other part."""
    if table.carries == carries:
        return table
    return Turntable(table.direction, table.point, -table.gain, -table.harmonics, table.basis, carries)


def _pointed_up(
    result: Adjustment, observations: Observations, data: Prepared, settings: CalibrationSettings
) -> Adjustment:
    """The seed points up; only an axis that lies across the image can have swung over since."""
    before = result.problem.scanner.turntable
    table = point_up(before, observations.up)
    if table is before:
        return result
    problem = eqx.tree_at(lambda p: p.scanner.turntable, result.problem, table)
    return adjust(problem, data, settings)


def _calibration(
    result: Adjustment,
    observations: Observations,
    data: Prepared,
    settings: CalibrationSettings,
    started: float,
    camera_only: bool = False,
) -> Calibration:
    problem = jax.tree.map(np.asarray, result.problem)
    named = _named(problem.scanner, observations, None)
    names = shared_names(named)
    determination = determine(
        np.asarray(result.linearised.reduced), np.asarray(result.linearised.prior), problem.scales, names
    )
    if determination is None:
        raise CalibrationError(
            "The observations leave a combination of parameters undetermined: capture more board poses, tilted by 20 "
            "to 45 degrees and all over the image, and hold what is not needed (`free`)."
        )
    order = named.camera.parameter_names() if camera_only else named.parameter_names()
    turned = -1.0 if observations.carries == "object" else 1.0
    sign = np.array([turned if name in ANGLE_PARAMETERS else 1.0 for name in order])
    covariance = determination.covariance[: len(order), : len(order)] * np.outer(sign, sign)
    quality = _quality(result, determination, observations, data, names)
    quality["seconds"] = time.perf_counter() - started
    return Calibration(
        camera=named.camera,
        scanner=None if camera_only else _named(problem.scanner, observations, covariance),
        order=order,
        covariance=covariance,
        quality=quality,
        observations=observations,
        provenance={"settings": {"free": list(settings.free), "priors": vars(settings.priors)}},
    )


def _quality(
    result: Adjustment,
    determination: Determination,
    observations: Observations,
    data: Prepared,
    names: tuple[str, ...],
) -> dict[str, Any]:
    distance = np.linalg.norm(result.corner_error, axis=-1)
    corners, stripes = int(data.corner_valid.sum()), int(data.stripe_valid.sum())
    kept, kept_stripes = int(result.corner_keep.sum()), int(result.stripe_keep.sum())
    prior = np.asarray(result.linearised.residual.prior)
    cost = sum(float(np.sum(np.square(part))) for part in result.linearised.residual)
    prior_cost = float(np.sum(prior**2)) / max(cost, 1e-300)
    warp = slice(len(names) - 2, len(names))
    quality: dict[str, Any] = {
        "corner_rms_px": _rms(distance[result.corner_keep]),
        "corner_rms_all_px": _rms(distance[data.corner_valid]),
        "stripe_rms_px": _rms(result.stripe_error[result.stripe_keep]),
        "corner_rms_whitened": result.corner_rms,
        "stripe_rms_whitened": result.stripe_rms,
        "corner_noise_over_sigma": result.corner_noise,
        "stripe_noise_over_sigma": result.stripe_noise,
        "views": int(data.usable.sum()),
        "views_without_board": int(len(np.asarray(observations.corners.angle)) - data.usable.sum()),
        "placements": len(np.unique(data.placement[data.usable])),
        "corners": corners,
        "corners_rejected": corners - kept,
        "stripe_points": stripes,
        "stripe_points_rejected": stripes - kept_stripes,
        "per_view": _per_view(result, observations, data, distance),
        "condition": determination.condition,
        "unobserved": determination.unobserved,
        "prior_share": {"cost": prior_cost, "information": determination.prior_share},
        "prior_residuals": _prior_residuals(prior, len(observations.laser_names) or 1),
        "board_warp_m": [float(value) for value in result.problem.warp],
        "board_warp_sigma_m": [float(v) for v in np.sqrt(np.diag(determination.covariance)[warp])],
        "steps": result.steps,
    }
    quality["warnings"] = _warnings(quality)
    return quality


def _per_view(
    result: Adjustment, observations: Observations, data: Prepared, distance: np.ndarray
) -> list[dict[str, float | int]]:
    records = np.asarray(observations.corners.record)
    depth = np.asarray(camera_from_board(result.problem))[:, 2, 3]
    views = []
    for view in np.flatnonzero(data.usable):
        seen = data.corner_valid[view]
        rows = data.stripe_view == view
        points = result.stripe_keep & rows[:, None]
        views.append(
            {
                "record": int(records[view]),
                "corners": int(seen.sum()),
                "corners_rejected": int((seen & ~result.corner_keep[view]).sum()),
                "corner_rms_px": _rms(distance[view, seen]),
                "stripe_points": int(points.sum()),
                "stripe_rms_px": _rms(result.stripe_error[points]),
                "board_z_m": float(depth[view]),
            }
        )
    return views


def _prior_residuals(prior: np.ndarray, lasers: int) -> dict[str, float]:
    """Departure of each prior's parameter in units of the prior's standard deviation (largest of the lasers)."""
    found: dict[str, float] = {}
    for name, value in zip(prior_names(lasers), prior, strict=True):
        label = "fx/fy" if name == "fx" else name
        if abs(value) > abs(found.get(label, 0.0)):
            found[label] = float(value)
    return found


def _warnings(quality: dict[str, Any]) -> list[str]:
    warnings = []
    if quality["prior_share"]["cost"] > _PRIOR_COST_WARNING:
        warnings.append(f"priors carry {100 * quality['prior_share']['cost']:.1f} % of the cost")
    for group in ("corners", "stripe_points"):
        if quality[f"{group}_rejected"] > _REJECTED_WARNING * max(quality[group], 1):
            share = 100 * quality[f"{group}_rejected"] / quality[group]
            warnings.append(f"{share:.1f} % of the {group.replace('_', ' ')} were rejected")
    for view in quality["per_view"]:
        if view["corners_rejected"] > 0.2 * view["corners"]:
            warnings.append(
                f"record {view['record']}: {view['corners_rejected']} of {view['corners']} corners rejected"
            )
    for direction in quality["unobserved"]:
        # The table's own angle errors are meant to be held by what is known of tables.
        if not set(direction) & set(ANGLE_PARAMETERS):
            warnings.append(f"held by priors rather than by data: {', '.join(direction)}")
    return warnings


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0
