"""Observations to a calibration: first values, joint solve, verdict; and which of two looks to keep."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import numpy as np

from jaxscan.calibration.adjust import Adjustment, adjust, not_converged, undetermined_shares
from jaxscan.calibration.board_shape import ShapeChoice, choose_shape, describe_board
from jaxscan.calibration.conclude import conclude
from jaxscan.calibration.first_values import average_placements, seed_camera, seed_motion, seed_poses
from jaxscan.calibration.hand_eye import with_hand
from jaxscan.calibration.problem import Prepared, Problem, bend_of, make_problem, prepare
from jaxscan.calibration.result import Calibration, SecondLook
from jaxscan.calibration.rigs import NOTHING_KNOWN, Holdings, KnownParts, Rig, has_moved, largest_rig
from jaxscan.calibration.settings import CAMERA_BLOCKS, CalibrationSettings
from jaxscan.calibration.sheets import seed_sheets
from jaxscan.errors import CalibrationError
from jaxscan.geometry import (
    MOTIONS,
    AbstractCamera,
    AbstractMotion,
    LaserSheet,
    Scanner,
    Still,
    carrying,
    motion_class,
    motion_of,
    point_up,
    stack_lasers,
)
from jaxscan.leastsq import Huber
from jaxscan.observation import Observations, SolvedRig, with_lasers


@contextlib.contextmanager
def _contradictions() -> Iterator[None]:
    """Report equations without a solution as a fault of the observations."""
    try:
        yield
    except np.linalg.LinAlgError as problem:
        raise CalibrationError(
            f"The observations contradict each other, so no calibration fits them ({problem}): check the board's size "
            "and the angles of the table, or capture the board again."
        ) from problem


@dataclass(frozen=True)
class Estimate:
    """A rig estimated from observations, and not yet judged."""

    adjustment: Adjustment
    """The solve."""
    shape: ShapeChoice
    """The shape of the board that was freed in this estimate."""
    observations: Observations
    """Observations with only those lines on the boards that were taken for lines of the lasers."""
    given: Observations
    """Observations of the same lasers, before lines were left out."""
    rig: Rig
    camera: AbstractCamera
    """The camera with its size, and without coefficients that were not requested."""
    seconds: float
    hand: AbstractMotion | None = None
    """First values of the place of the camera on a hand whose poses are given."""


def calibrate_observations(
    observations: Observations, *, settings: CalibrationSettings | None = None, known: KnownParts = NOTHING_KNOWN
) -> Calibration:
    """Camera, laser sheets and motion in one least-squares problem, with their covariance.

    The largest rig is solved that the observations determine. Closed-form first values; then a robust
    joint solve, rejection of outliers, estimation of the noise of corners and stripes, and a last
    plain solve. Runs in float64 whatever the caller's JAX settings.

    Args:
        observations: Board corners, stripes on boards, positions of table or stage.
        settings: Free blocks, priors, thresholds; a smaller rig on purpose.
        known: Parts that are held, or refined.

    Returns:
        The calibration; its `quality` says first whether the solve converged, and with
        `settings.judge` it has predicted lengths and a verdict. `missing` names the parts that were not solved.

    Raises:
        CalibrationError: If the observations do not determine a camera, contradict each other, or are not of the
            known parts.

    Source: the paper, equations (1)-(12), solved together.
    """
    settings = settings or CalibrationSettings()
    return judge(estimate(observations, settings=settings, known=known), settings=settings, known=known)


def estimate(
    observations: Observations,
    *,
    settings: CalibrationSettings,
    known: KnownParts = NOTHING_KNOWN,
    before: Estimate | None = None,
) -> Estimate:
    """Solve for the rig, as `calibrate_observations` does, without judging it.

    Args:
        observations: As there.
        settings: As there.
        known: As there.
        before: An estimate from a first look at the same boards; this one begins with its camera.

    Raises:
        CalibrationError: As there.
    """
    started = time.perf_counter()
    known.check((observations.width, observations.height), observations.laser_names, observations.carries)
    settings = replace(settings, free=known.free(settings))
    with jax.enable_x64(True), _contradictions():
        data = prepare(observations)
        rig = _rig(data, observations, settings, known)
        observations, data = _of_rig(observations, data, rig)
        given = observations
        camera, poses, converged = _first_camera(data, observations, rig, settings, known, before)
        try:
            motion = known.motion if rig.moves else Still()
            if motion is None:
                motion = seed_motion(poses, data, observations)
            motion, hand = (Still(), motion) if observations.poses is not None else (motion, None)
            named = _named(camera, observations, settings)
            lasers, observations, reasons = _first_sheets(data, named, poses, observations, rig, known)
        except CalibrationError:
            if converged:
                raise
            # A diagnosis would describe numbers that mean nothing.
            raise CalibrationError(not_converged(settings)) from None
        if reasons and not converged:
            raise CalibrationError(not_converged(settings))
        if rig.lasers:
            solved = tuple(name for name in rig.lasers if name not in reasons)
            rig = replace(rig, lasers=solved, missing=(*rig.missing, *reasons.values()))
            data = prepare(observations) if solved else _without_stripes(data)
            given = with_lasers(given, solved) if solved else observations
        # Without a motion that is known, and where poses are given, every view has a pose of its own.
        data = _apart(data) if isinstance(motion, Still) else data
        placements = average_placements(poses, data, motion)
        problem = make_problem(camera, stack_lasers(lasers), motion, placements, data, settings)
        result = _pointed_up(adjust(problem, data, settings), observations, settings)
        result, shape = choose_shape(result, observations, settings)
        named = _named(result.problem.camera, observations, settings)
    return Estimate(result, shape, observations, given, rig, named, time.perf_counter() - started, hand)


def judge(found: Estimate, *, settings: CalibrationSettings, known: KnownParts = NOTHING_KNOWN) -> Calibration:
    """The calibration that an estimate gives: covariance, quality, and with `settings.judge` a verdict.

    Raises:
        CalibrationError: If the observations do not determine the parameters.
    """
    started, settings = time.perf_counter(), replace(settings, free=known.free(settings))
    with jax.enable_x64(True), _contradictions():
        calibration = conclude(found.adjustment, found.camera, found.observations, settings, found.given)
        board = describe_board(found.adjustment, found.observations, calibration, found.shape)
        if found.rig.moves and found.hand is not None and found.adjustment.converged:
            held = "axis" in known.held()
            calibration = with_hand(calibration, found.adjustment, found.observations, found.hand, held=held)
    seconds = found.seconds + time.perf_counter() - started
    quality = replace(calibration.quality, board=board, seconds=seconds)
    provenance = {**calibration.provenance, "held": list(known.held())} if known.held() else calibration.provenance
    return replace(calibration, quality=quality, missing=found.rig.missing, provenance=provenance)


def calibrate_camera(observations: Observations, *, settings: CalibrationSettings | None = None) -> Calibration:
    """The camera alone, from boards in any poses; stripes, angles and placements are not used.

    Returns:
        A calibration without a scanner; `order` and `covariance` are the camera's.

    Raises:
        CalibrationError: If the views do not determine a camera.

    Source: the paper, equations (1)-(3), after Zhang.
    """
    return calibrate_observations(observations, settings=replace(settings or CalibrationSettings(), only="camera"))


def _rig(data: Prepared, observations: Observations, settings: CalibrationSettings, known: KnownParts) -> Rig:
    """The largest rig that the observations determine."""
    views = np.flatnonzero(data.fixes_pose)
    if len(views) == 0:
        raise CalibrationError(
            "The board was not found in any view: "
            "check `[board]` in capture.toml (type, columns, rows) and the exposure."
        )
    lit = {
        name: bool((data.stripe_valid & (data.stripe_laser == index)[:, None]).any())
        for index, name in enumerate(observations.laser_names)
    }
    placed = zip(data.placement[views].tolist(), data.angle[views].tolist(), strict=True)
    held = Holdings(len(views), lit, has_moved(placed, observations.carries), observations.carries)
    return largest_rig(held, settings.only, known, seen="where the board was found")


def _of_rig(observations: Observations, data: Prepared, rig: Rig) -> tuple[Observations, Prepared]:
    """The observations of only those lasers that are solved."""
    if rig.lasers == observations.laser_names:
        return observations, data
    if rig.lasers:
        observations = with_lasers(observations, rig.lasers)
        return observations, prepare(observations)
    return observations, _without_stripes(data)


def _first_sheets(
    data: Prepared, camera: AbstractCamera, poses: np.ndarray, observations: Observations, rig: Rig, known: KnownParts
) -> tuple[list[LaserSheet], Observations, dict[str, str]]:
    """First sheets, with the observations that agree with them, and for each laser without one a sentence why."""
    if known.sheets or not rig.lasers:
        return list(known.sheets), observations, {}
    try:
        return *seed_sheets(observations, data, camera, poses), {}
    except CalibrationError as problem:
        if len(rig.lasers) == 1:
            return [], observations, {rig.lasers[0]: f"no sheet: {problem}"}
    # One laser that shows no sheet must not cost the others theirs.
    reasons: dict[str, str] = {}
    for name in rig.lasers:
        own = with_lasers(observations, (name,))
        try:
            seed_sheets(own, prepare(own), camera, poses)
        except CalibrationError as problem:
            reasons[name] = f"no sheet of laser {name!r}: {problem}"
    solved = [name for name in rig.lasers if name not in reasons]
    observations = with_lasers(observations, solved)
    return (
        (*seed_sheets(observations, prepare(observations), camera, poses), reasons)
        if solved
        else ([], observations, reasons)
    )


def _first_camera(
    data: Prepared,
    observations: Observations,
    rig: Rig,
    settings: CalibrationSettings,
    known: KnownParts,
    before: Estimate | None,
) -> tuple[AbstractCamera, np.ndarray, bool]:
    """A camera and the poses of all views [views, 4, 4] by corners alone, and whether the solve for them converged."""
    # Each view by itself, without stripes and table: lasers and table are held and meet no
    # observation, so that this solve and the joint one are one compiled function.
    apart = _apart(data)._replace(stripe_valid=np.zeros_like(data.stripe_valid))
    if before is not None:
        camera = before.adjustment.problem.camera
        return camera, seed_poses(apart, camera), True
    if known.camera is None:
        cameras, poses = seed_camera(apart, settings.camera)
    else:
        # The camera has all coefficients that the model knows, like first cameras.
        camera, names = known.camera, [name for block in known.camera.lens for name in block.parameters]
        lens = np.pad(np.asarray(camera.distortion), (0, len(names) - len(camera.distortion)))
        camera = replace(camera, distortion=lens)
        cameras, poses = [camera], seed_poses(apart, camera)
    if len(cameras) == 1 and not rig.lasers and not rig.moves:
        return cameras[0], poses, True
    held = replace(settings, free=tuple(block for block in settings.free if block in CAMERA_BLOCKS))
    stand_ins = _stand_ins(rig)
    first = _lowest([make_problem(camera, *stand_ins, poses, apart, held) for camera in cameras], apart, settings)
    return first.problem.camera, np.asarray(first.problem.poses), first.converged


def _lowest(starts: list[Problem], data: Prepared, settings: CalibrationSettings) -> Adjustment:
    """The robust solve that fits the corners best, among those from each start."""

    def cost(found: Adjustment) -> float:
        size = np.linalg.norm(found.corner_error, axis=-1)[data.corner_valid] / data.corner_sigma[data.corner_valid]
        return float(np.sum((Huber(settings.huber).weights(size) * size) ** 2))

    return min((adjust(start, data, settings, rejection=False) for start in starts), key=cost)


def _apart(data: Prepared) -> Prepared:
    """Observations in which every view is its own placement, so that a board moved by mistake does no harm."""
    return data._replace(
        placement=np.where(data.fixes_pose, np.arange(len(data.fixes_pose)), 0).astype(np.int32),
        angle=np.zeros_like(data.angle),
        stop=np.zeros_like(data.stop),
    )


def _without_stripes(data: Prepared) -> Prepared:
    return data._replace(**{name: getattr(data, name)[:0] for name in data._fields if name.startswith("stripe_")})


def _stand_ins(rig: Rig) -> tuple[LaserSheet, AbstractMotion]:
    # Any: they are held, and meet no observation.
    sheet = LaserSheet.from_plane(np.array([1.0, 0.0, 0.0]), 1.0)
    motion: AbstractMotion = Still()
    if rig.moves and MOTIONS[rig.carries].unit != "pose":
        shapes = {key: field.shape for key, field in motion_class(rig.carries).fields.items()}
        motion = motion_of(rig.carries, **{key: [1.0, 0.0, 0.0] for key, shape in shapes.items() if shape == (3,)})
    return stack_lasers([sheet] * len(rig.lasers)), motion


def _named(camera: AbstractCamera, observations: Observations, settings: CalibrationSettings) -> AbstractCamera:
    """The solver's camera with its size, and without optional coefficients that were not requested."""
    distortion = np.asarray(camera.distortion)
    count = sum(len(block.parameters) for block in camera.lens if not block.optional or block.name in settings.free)
    # A known camera may have them.
    count = count if not distortion[count:].any() else len(distortion)
    distortion = distortion[:count]
    return replace(camera, distortion=distortion, width=observations.width, height=observations.height)


def _pointed_up(result: Adjustment, observations: Observations, settings: CalibrationSettings) -> Adjustment:
    """The seed points up; only an axis that lies across the image can have swung over since."""
    before = result.problem.turntable
    table = point_up(before, observations.up)
    if table is before:
        return result
    return adjust(eqx.tree_at(lambda p: p.turntable, result.problem, table), result.data, settings)


# The second solve may whiten worse by this factor: corners at the rim of the image are harder to explain. What is no
# larger than the detectors promise is explained: a first look may hide an error of its own that the solve takes up.
_NOT_WORSE = 1.05
# Share of the boards with a line that must agree with a sheet, so that stripes are looked for near it only.
_BELIEVED = 0.5


def solved_rig(found: Estimate) -> SolvedRig | None:
    """The rig and its boards, from which new places of corners and stripes are predicted.

    None of a solve that did not converge, or leaves parameters undetermined: it predicts nothing.
    """
    result, observations = found.adjustment, found.observations
    problem = result.problem
    if not result.converged or undetermined_shares(result.linearised, np.asarray(problem.scales)).any():
        return None
    scanner = None
    if found.rig.lasers or found.rig.moves:
        motion = carrying(problem.turntable, observations.carries)
        scanner = Scanner(found.camera, problem.lasers, motion, None, found.rig.lasers, observations.up)
    views, corners = np.shape(observations.corners.valid)
    bend, offset = bend_of(problem)
    squares = np.sum(result.corner_error[result.corner_inlier] ** 2, axis=-1)
    return SolvedRig(
        camera=found.camera,
        scanner=scanner,
        board=observations.board,
        shape=np.asarray(problem.shape)[:3],
        bend=bend,
        offset=offset[:corners],
        poses=result.linearised.view_poses[:views],
        used=np.any(result.corner_inlier, axis=1)[:views],
        corner_rms_px=float(np.sqrt(squares.mean())) if squares.size else 0.0,
        believed=_believed(observations),
    )


def _believed(observations: Observations) -> tuple[str, ...]:
    """The lasers whose sheets contain the lines of most boards: a stripe elsewhere has a row without a point."""
    laser, found = np.asarray(observations.stripes.laser), np.any(np.asarray(observations.stripes.valid), axis=1)
    own = {name: found[laser == index] for index, name in enumerate(observations.laser_names)}
    return tuple(name for name, lit in own.items() if lit.sum() > _BELIEVED * len(lit))


def choose(first: Estimate, second: Estimate) -> tuple[Estimate, SecondLook]:
    """The second estimate, unless it explains its observations worse; and the gains of the second look."""
    before, after = (_explained(one) for one in (first, second))
    # A look that loses a part of the rig would explain the rest of its observations well.
    whole = set(first.rig.lasers) <= set(second.rig.lasers) and (second.rig.moves or not first.rig.moves)
    names = "corner_rms_whitened", "stripe_rms_whitened"
    explains = all(after[name] <= _NOT_WORSE * max(before[name], 1.0) for name in names)
    kept = whole and second.adjustment.converged and explains
    look = SecondLook(
        kept,
        views_gained=int(after["views"] - before["views"]),
        corners_gained=int(after["corners"] - before["corners"]),
        stripe_points_gained=int(after["stripe_points"] - before["stripe_points"]),
        corner_rms_whitened_before=before["corner_rms_whitened"],
        stripe_rms_whitened_before=before["stripe_rms_whitened"],
        corner_rms_whitened_after=after["corner_rms_whitened"],
        stripe_rms_whitened_after=after["stripe_rms_whitened"],
    )
    return second if kept else first, look


def _explained(found: Estimate) -> dict[str, float]:
    data, (corner_rms, stripe_rms) = found.adjustment.data, found.adjustment.whitened_rms()
    return {
        "corner_rms_whitened": corner_rms,
        "stripe_rms_whitened": stripe_rms,
        "views": int(data.fixes_pose.sum()),
        "corners": int(data.corner_valid.sum()),
        "stripe_points": int(data.stripe_valid.sum()),
    }
