"""Observations to a calibration: seed, joint solve, covariance, and numbers to judge it by."""

import time
from dataclasses import asdict, replace
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxscan.calibration.observations import Observations
from jaxscan.calibration.parameters import ANGLE_PARAMETERS, BOARD_BLOCKS, CAMERA_BLOCKS
from jaxscan.calibration.result import Calibration, Fit
from jaxscan.calibration.seed.camera import seed_camera
from jaxscan.calibration.seed.closed_form import average_placements, lift_stripes, seed_axis, seed_plane
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjust import Adjustment, adjust
from jaxscan.calibration.solve.assemble import carrying, make_problem
from jaxscan.calibration.solve.covariance import determine
from jaxscan.calibration.solve.noise import huber_weights
from jaxscan.calibration.solve.prepare import Prepared, prepare
from jaxscan.calibration.solve.problem import Problem
from jaxscan.calibration.verdict.advice import advise, cures
from jaxscan.calibration.verdict.judge import ACCEPTED_P, ModelTest, chance, judge
from jaxscan.calibration.verdict.lengths import length_changes, length_sigma, predict_lengths, typical_lengths
from jaxscan.calibration.verdict.quality import describe_quality
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera, LaserSheet, Scanner, Turntable, make_layout, point_up, stack_lasers
from jaxscan.geometry.scanner import UP_VECTORS


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
        `condition`, `unobserved`, `spectrum`, `prior_share`, `board_warp_m`, `views_dropped`, `steps`,
        `seconds`, `warnings`; and, with `settings.judge`, `lengths` (see `predict_lengths`) and
        `verdict` (`accepted`, `p`, `p_structure`, `tests` of `judge`, `advice`).

    Raises:
        CalibrationError: If the observations do not determine the scanner; it says what to capture.

    Source: PAPER.md equations (1)-(12), solved together.
    """
    settings = settings or CalibrationSettings()
    started = time.perf_counter()
    if not observations.laser_names:
        raise CalibrationError("The observations name no laser, so there is no laser sheet to be found.")
    with jax.enable_x64(True):
        data = prepare(observations)
        # Each view by itself, without stripes and table: what is not the camera is held and meets no
        # observation, so that both solves are one compiled function.
        apart = _apart(data)._replace(stripe_valid=np.zeros_like(data.stripe_valid))
        cameras, poses = seed_camera(apart, settings.camera)
        free = tuple(block for block in settings.free if block in CAMERA_BLOCKS)
        held, stand_ins = replace(settings, free=free), _stand_ins(observations)
        starts = [make_problem(camera, *stand_ins, poses, apart, held) for camera in cameras]
        first = _lowest(starts, apart, settings)
        camera, poses = _named(first.camera, observations, settings), np.asarray(first.poses)
        lasers = [
            seed_plane(lift_stripes(data, camera, poses, index), name)
            for index, name in enumerate(observations.laser_names)
        ]
        table = seed_axis(poses, data, observations.carries, observations.up)
        placements = average_placements(poses, data, table)
        problem = make_problem(first.camera, stack_lasers(lasers), table, placements, data, settings)
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
    free = tuple(block for block in settings.free if block in (*CAMERA_BLOCKS, "warp", "pitch"))
    settings = replace(settings, free=free)
    with jax.enable_x64(True):
        data = _without_stripes(_apart(prepare(observations)))
        cameras, poses = seed_camera(data, settings.camera)
        starts = [make_problem(camera, None, None, poses, data, settings) for camera in cameras]
        problem = starts[0] if len(starts) == 1 else _lowest(starts, data, settings)
        return _calibration(adjust(problem, data, settings), observations, data, settings, started)


def _lowest(starts: list[Problem], data: Prepared, settings: CalibrationSettings) -> Problem:
    """The end of a robust solve from each start, and of these the one that fits the corners best."""

    def cost(found: Adjustment) -> float:
        size = np.linalg.norm(found.corner_error, axis=-1)[data.corner_valid] / data.corner_sigma[data.corner_valid]
        return float(np.sum(huber_weights(size, settings.huber) ** 2 * size**2))

    return min((adjust(start, data, settings, rejection=False) for start in starts), key=cost).problem


def _apart(data: Prepared) -> Prepared:
    """Every view a placement of its own, so that a board moved by mistake does no harm."""
    return data._replace(
        placement=np.where(data.usable, np.arange(len(data.usable)), 0).astype(np.int32),
        angle=np.zeros_like(data.angle),
    )


def _without_stripes(data: Prepared) -> Prepared:
    return data._replace(
        stripe_q=data.stripe_q[:0],
        stripe_sigma=data.stripe_sigma[:0],
        stripe_valid=data.stripe_valid[:0],
        stripe_view=data.stripe_view[:0],
        stripe_laser=data.stripe_laser[:0],
    )


def _stand_ins(observations: Observations) -> tuple[LaserSheet, Turntable]:
    sheet = LaserSheet.from_plane(np.array([1.0, 0.0, 0.0]), 1.0)
    table = Turntable.from_axis(np.array(UP_VECTORS[observations.up]), np.array([0.0, 0.0, -0.1]))
    return stack_lasers([sheet] * len(observations.laser_names)), table


def _named(camera: AbstractCamera, observations: Observations, settings: CalibrationSettings) -> AbstractCamera:
    """The solver's camera with its size, and without optional coefficients that nobody asked for."""
    count = sum(len(block.parameters) for block in camera.lens if not block.optional or block.name in settings.free)
    distortion = np.asarray(camera.distortion)[:count]
    return replace(camera, distortion=distortion, width=observations.width, height=observations.height)


def _pointed_up(
    result: Adjustment, observations: Observations, data: Prepared, settings: CalibrationSettings
) -> Adjustment:
    """The seed points up; only an axis that lies across the image can have swung over since."""
    before = result.problem.turntable
    table = before if before is None else point_up(before, observations.up)
    if table is before:
        return result
    return adjust(eqx.tree_at(lambda p: p.turntable, result.problem, table), data, settings)


def _calibration(
    result: Adjustment, observations: Observations, data: Prepared, settings: CalibrationSettings, started: float
) -> Calibration:
    problem, table = result.problem, result.problem.turntable
    camera = _named(problem.camera, observations, settings)
    lasers = observations.laser_names if table is not None else ()
    names = make_layout(problem.camera, lasers, turns=table is not None, board=BOARD_BLOCKS).names
    scales = np.asarray(problem.scales)
    determination = determine(result.linearised, scales, names)
    if isinstance(determination, dict):
        wanted = "; ".join(cures([determination])) or "boards tilted by 20 to 45 degrees all over the image"
        raise CalibrationError(
            f"The observations say nothing about a combination of {', '.join(determination)}: capture {wanted}, or "
            "hold what is not needed (`free`)."
        )
    layout = make_layout(camera, lasers, turns=table is not None, board=BOARD_BLOCKS)
    every, count = layout.names, layout.board.start
    kept = np.array([names.index(name) for name in every])
    turned = -1.0 if observations.carries == "object" else 1.0
    sign = np.array([turned if name in ANGLE_PARAMETERS else 1.0 for name in every])
    covariance = determination.covariance[np.ix_(kept, kept)] * np.outer(sign, sign)
    own = np.ascontiguousarray(covariance[:count, :count])
    scanner = None
    if table is not None:
        named_table = carrying(table, observations.carries)
        scanner = Scanner(camera, problem.lasers, named_table, own, lasers, observations.up)
    quality = describe_quality(result, determination, observations, data, names)
    if scanner is not None and settings.judge:
        quality["lengths"] = predict_lengths(scanner)
    if settings.judge:
        tests = judge(result, data, settings)
        structure = chance([test.p_structure for test in tests])
        quality["verdict"] = {
            "accepted": structure > ACCEPTED_P,
            "p": chance([test.p for test in tests]),
            "p_structure": structure,
            "tests": _described(tests, scanner, sign[:count] * scales[kept[:count]], kept[:count]),
            "advice": advise(result, data, determination.unobserved),
        }
    quality["seconds"] = time.perf_counter() - started
    return Calibration(
        camera=camera,
        scanner=scanner,
        order=every[:count],
        covariance=own,
        quality=quality,
        observations=observations,
        provenance={"settings": asdict(settings)},
        fit=_fit(result, observations, covariance),
    )


def _described(
    tests: list[ModelTest], scanner: Scanner | None, units: np.ndarray, kept: np.ndarray
) -> list[dict[str, Any]]:
    """The tests as JSON, with what each model's lack would do to typical lengths [mm]."""
    described = [{key: value for key, value in test._asdict().items() if key != "shift"} for test in tests]
    lengths = (
        [] if scanner is None else [one for i in range(len(scanner.laser_names)) for one in typical_lengths(scanner, i)]
    )
    if scanner is None or not lengths:
        return described
    known = [i for i, test in enumerate(tests) if test.shift is not None]
    steps = np.array([units * test.shift[kept] for test in tests if test.shift is not None])
    change, sigma = length_changes(scanner, lengths, steps), length_sigma(scanner, lengths)
    for row, i in enumerate(known):
        share = np.abs(change[row]) / np.where(sigma > 0, sigma, np.inf)
        worst = int(np.argmax(share))
        described[i] |= {"effect_mm": 1e3 * float(abs(change[row, worst])), "effect_sigma": float(share[worst])}
    return described


def _fit(result: Adjustment, observations: Observations, covariance: np.ndarray) -> Fit:
    """What became of every observation, without padding."""
    views, corners = np.shape(observations.corners.valid)
    stripes, points = np.shape(observations.stripes.valid)
    corner = lambda values: np.ascontiguousarray(values[:views, :corners])
    stripe = lambda values: np.ascontiguousarray(values[:stripes, :points])
    kx, ky, pitch = (float(value) for value in result.problem.shape)
    leverage = np.asarray(result.linearised.corner_leverage).reshape(result.corner_error.shape)
    return Fit(
        pose=np.asarray(result.linearised.view_poses)[:views],
        warp=np.array([kx, ky]),
        pitch=pitch,
        corner_error=corner(result.corner_error),
        corner_sigma=corner(result.corner_sigma),
        corner_leverage=corner(leverage),
        corner_kept=corner(result.corner_keep),
        stripe_error=stripe(result.stripe_error),
        stripe_sigma=stripe(result.stripe_sigma),
        stripe_leverage=stripe(np.asarray(result.linearised.stripe_leverage)),
        stripe_kept=stripe(result.stripe_keep),
        covariance=covariance,
    )
