"""The joint adjustment round the solver: robust start, rejection of outliers, noise learned, covariance."""

from collections.abc import Mapping
from dataclasses import replace

import jax
import numpy as np

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.leastsq import Cauchy, Covariance, keep_inliers, robust_noise
from jaxscan.recalibration.adjust.boards import board_equations, prepare_boards, with_boards
from jaxscan.recalibration.adjust.noise import FIRST_WALL_M, Noise, learn_noise, shared_by_profiles
from jaxscan.recalibration.adjust.prepare import Prepared, prepare
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, Unknowns
from jaxscan.recalibration.adjust.solver import linearise, solve, step_of
from jaxscan.recalibration.adjust.state import State, conclude
from jaxscan.recalibration.adjust.wall_shape import STOPS, beside_shape, learn_heights
from jaxscan.recalibration.observed import RecalibrationSettings, RoomObservations
from jaxscan.recalibration.result import Adjusted, Start


# Damping at the start of a solve, relative to J'J: cautious from a poor calibration, a plain Gauss-Newton step
# where the last solve ended beside the minimum.
_FIRST_DAMPING, _NEAR_DAMPING = 1e-4, 1e-10
# Root mean square change at which a solve stops: while weights still change, and at the end.
_ROUGH, _FINE = 1e-3, 1e-6
_ROBUST_ROUNDS, _REJECTION_ROUNDS = 6, 8
_REJECT_ANY, _REJECT_ALL = 5.0, 4.0
# Share by which the noise may still change in the last round, and a station of its standard deviation in the last step.
_SETTLED = 0.01
# The problem is nearly linear beside the minimum of plain least squares; less so where a station can slide along walls.
_SHAPE_STEPS = 16
# Parts of such a step that are tried.
_PARTS = 0.5 ** np.arange(5)
# Share by which the sum of squares may rise in such a step, by rounding.
_RISE = 1e-9


def adjust(
    prior: Scanner,
    start: Start,
    observations: RoomObservations,
    settings: RecalibrationSettings | None = None,
    *,
    loosened: Mapping[str, float] | None = None,
) -> Adjusted:
    """Scanner, stations, surfaces and angles in one least squares of all observations and the stored calibration.

    Robust first; then outliers are rejected, the roughness of walls and the noise of stripes are learned from the
    residuals, and a plain least squares is the estimate of maximum likelihood. Runs in float64 whatever the caller's
    JAX settings.

    Args:
        prior: The stored scanner with its covariance; parameters without variance are held.
        start: Where steps begin, poses of the stations, and known faults of angles.
        observations: Stripe points on surfaces; perhaps tracked features, known lengths and boards.
        settings: Of the recalibration.
        loosened: Standard deviations that are added to the prior, by the name of a minimal coordinate: where a part
            may have moved since [px, rad, m].

    Returns:
        The adjusted scanner with its covariance, stations, surfaces, and residuals of everything.

    Raises:
        CalibrationError: If the stored calibration has no covariance, or the observations contradict each other.
    """
    settings = settings or RecalibrationSettings()
    with jax.enable_x64(True):
        prepared = prepare(prior, start, observations, settings, loosened or {})
        try:
            state = _robust(_begin(prepared, observations, settings, prior), settings)
            state = _shaped(_reject(state, settings), settings)
        except np.linalg.LinAlgError as problem:
            raise CalibrationError(
                f"The captures contradict each other, so no adjustment fits them ({problem}): check that they are of "
                "this rig and of one room."
            ) from problem
        return conclude(state, prior, observations)


def _begin(
    prepared: Prepared, observations: RoomObservations, settings: RecalibrationSettings, prior: Scanner
) -> State:
    wall = FIRST_WALL_M if settings.wall_m is None else settings.wall_m
    linearised = linearise(prepared.room, prepared.y)
    data = None if observations.boards is None else prepare_boards(observations.boards, prior)
    seen = prepared.usable, prepared.seen
    return State(prepared, observations, prepared.y, linearised, *seen, Noise(1.0, wall), data, stated_wall_m=wall)


def _robust(state: State, settings: RecalibrationSettings) -> State:
    """Solves with a loss that outliers do not pull, until the size of the residuals settles."""
    before = np.inf
    for _ in range(_ROBUST_ROUNDS):
        size, seen = np.abs(state.whitened()), np.abs(state.sighting_whitened()).max(1, initial=0.0)
        scale = robust_noise(size[state.usable]), robust_noise(seen[state.prepared.seen])
        if max(scale) > 0.9 * before:
            break
        before = max(scale)
        weights = Cauchy().weights
        damp = weights(size / scale[0]) / scale[0], weights(seen / scale[1]) / scale[1]
        state = _solved(_with_boards(state), settings, _ROUGH, damp)
    return state


def _reject(state: State, settings: RecalibrationSettings) -> State:
    """Plain solves without outliers, with the noise that the residuals show."""
    limits = {"reject_any": _REJECT_ANY, "reject_all": _REJECT_ALL}
    state = replace(state, noise=_robust_noise_of(state, settings))
    for round_number in range(_REJECTION_ROUNDS):
        usable, seen = state.usable, state.prepared.seen
        size = np.abs(state.whitened()) / np.sqrt(state.redundancy())
        kept = usable & keep_inliers(size, usable, state.kept, **limits)
        far = np.abs(state.sighting_whitened()).max(1, initial=0.0) / state.sighting_noise
        sightings = keep_inliers(far, seen, state.sighting_kept, **limits)
        cleaned = replace(state, kept=kept, sighting_kept=sightings)
        cleaned = replace(cleaned, noise=_learned_noise(cleaned, settings))
        cleaned = _with_boards(replace(cleaned, sighting_noise=cleaned.learned_sighting_noise()))
        same = np.array_equal(kept, state.kept) and np.array_equal(sightings, state.sighting_kept)
        ratios = _ratios(cleaned, state)
        if round_number > 0 and same and max(abs(ratio - 1.0) for ratio in ratios) < _SETTLED:
            break
        state = _solved(cleaned, settings, _FINE)
    return state


def _shaped(state: State, settings: RecalibrationSettings) -> State:
    """Generalised least squares, in which walls have a shape of the size that the residuals show."""
    if not state.kept.any():
        return state
    heights = learn_heights(state.walls, state.plain_covariance, settings.angle_sigma)
    if heights[STOPS]:
        # Stops were taken for noise of the points.
        state = replace(state, noise=_learned_noise(state, settings, float(heights[STOPS])))
    wall = state.noise.wall_m
    if settings.wall_m is None:
        # Roughness was learned with the shape in it.
        wall = float(np.sqrt(max(wall**2 - np.sum(heights[:STOPS] ** 2), 0.0)))
    # Beside the shape neighbouring profiles say some of it twice.
    points, kept = state.observations.points, state.kept
    grid = np.stack([points.sweep, points.surface, points.record, points.line], 1)[kept]
    shared = np.sqrt(shared_by_profiles(beside_shape(state.whitened(), state.walls, heights)[kept], grid))
    noise = Noise(float(shared * state.noise.stripe), float(shared * wall))
    # Patches that follow the points would make every step another problem, where a station can slide along its walls.
    state = _with_boards(replace(state, noise=noise, heights=heights, patched=state.walls))
    room = state.weighted(1.0, 1.0)
    state = _moved(state, state.prepared._replace(room=room), state.y)
    for _ in range(_SHAPE_STEPS):
        step = step_of(room, state.shaped[0], state.covariance)
        near = np.sqrt(np.mean(step.scanner**2)) < _ROUGH and _settled(step, state.covariance)
        after = _stepped(state, step)
        if near:
            return after or state
        if after is None:
            break
        state = after
    # A step that was not taken, or not the last one: the caller must know that this is no minimum.
    return replace(state, converged=False)


def _stepped(state: State, step: Unknowns) -> State | None:
    """The state after the largest part of a step that does not raise the sum of squares; None where there is none."""
    for part in _PARTS:
        y = jax.tree.map(lambda old, new, part=part: np.asarray(old - part * new), state.y, step)
        if not all(np.isfinite(numbers).all() for numbers in y):
            break
        after = replace(_moved(state, state.prepared, y), steps=state.steps + 1)
        # Written so that a sum which is no number is no improvement either.
        if after.cost <= (1.0 + _RISE) * state.cost:
            return after
    return None


def _settled(step: Unknowns, covariance: Covariance) -> bool:
    """Whether the stations moved by a small part of their standard deviations."""
    first = len(step.scanner)
    sigma = np.sqrt(np.diag(covariance.shared)[first : first + len(step.stations)])
    return bool(np.all(np.abs(step.stations) < _SETTLED * sigma))


def _with_boards(state: State) -> State:
    """The state with the equations of captured boards, seen with its scanner."""
    if state.board_data is None:
        return state
    equations = board_equations(state.linearised.rig, state.board_data, state.boards)
    room = with_boards(state.prepared.room, np.asarray(state.y.scanner), equations)
    return replace(state, prepared=state.prepared._replace(room=room), boards=equations)


def _moved(state: State, prepared: Prepared, y: Unknowns) -> State:
    return replace(state, prepared=prepared, y=y, linearised=linearise(prepared.room, y))


def _ratios(after: State, before: State) -> tuple[float, ...]:
    mean = lambda state: float(np.mean(state.sigma_px)) if len(state.kept) else 1.0
    return (
        mean(after) / mean(before),
        after.sighting_noise / before.sighting_noise,
        # Boards look noisier from a scanner that does not fit them yet.
        *(_board_noise(after) / _board_noise(before)),
    )


def _board_noise(state: State) -> np.ndarray:
    """Of corners and of stripes, and how many of these share one error; of no captured boards, nothing."""
    if state.boards is None:
        return np.zeros(0)
    result = state.boards.result
    return np.array([result.corner_noise, *result.stripe_noise, result.stripe_correlation])


def _learned_noise(state: State, settings: RecalibrationSettings, stop_sigma: float = 0.0) -> Noise:
    """The noise of the kept points, without the part of the stops."""
    kept = state.kept
    by_stop = np.asarray(state.linearised.points.rows.angle)[: len(kept)] / ANGLE_SCALE
    square = state.error_px[kept] ** 2 / state.redundancy()[kept] - (stop_sigma * by_stop[kept]) ** 2
    return learn_noise(square, state.given_px[kept], state.reach[kept], settings.wall_m)


def _robust_noise_of(state: State, settings: RecalibrationSettings) -> Noise:
    """The noise by the median, with the shares that it has: outliers are still in."""
    if settings.wall_m is not None or not state.usable.any():
        return state.noise
    size = robust_noise(state.whitened()[state.usable])
    return Noise(state.noise.stripe, state.noise.wall_m * max(size, 0.1)) if size > 1 else state.noise


def _solved(
    state: State,
    settings: RecalibrationSettings,
    tolerance: float,
    damp: tuple[np.ndarray | float, np.ndarray | float] = (1.0, 1.0),
) -> State:
    """The state after one more solve, in which weights are damped by factors of the points and the sightings."""
    room = state.weighted(*damp)
    damping = _FIRST_DAMPING if state.steps == 0 else _NEAR_DAMPING
    found = solve(room, state.y, damping, tolerance, settings.max_steps)
    return replace(
        state,
        prepared=state.prepared._replace(room=room),
        y=found.y,
        linearised=found.linearised,
        steps=state.steps + int(found.steps),
        converged=bool(found.converged),
    )
