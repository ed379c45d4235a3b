"""The joint adjustment: robust start, rejection of outliers, noise learned, walls that have a shape, covariance."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.problem import Prepared as BoardData
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.leastsq import Arrow, Cauchy, Covariance, covariance_of, keep_inliers, noise_component, robust_noise
from jaxscan.recalibration.adjust.boards import BoardEquations, board_equations, prepare_boards, with_boards
from jaxscan.recalibration.adjust.errors import (
    FIRST_WALL_M,
    STOPS,
    Noise,
    Wall,
    beside_shape,
    find_walls,
    learn_heights,
    learn_noise,
    learn_stops,
    shared_by_profiles,
    with_shape,
)
from jaxscan.recalibration.adjust.prepare import FIRST_STOP, HELD_STOP, Prepared, prepare
from jaxscan.recalibration.adjust.room import (
    ANGLE_SCALE,
    LOCAL_SCALE,
    STATION_SCALE,
    Linearised,
    Room,
    Unknowns,
    linearise,
    solve,
    step_of,
)
from jaxscan.recalibration.observed import RecalibrationSettings, RoomObservations, Surfaces
from jaxscan.recalibration.result import Adjusted, Start


# Damping at the start of a solve, relative to J'J: cautious from a poor calibration, a plain Gauss-Newton step
# where the last solve ended beside the minimum.
_FIRST_DAMPING, _NEAR_DAMPING = 1e-4, 1e-10
_MAX_STEPS = 40
# Root mean square change at which a solve stops: while weights still change, and at the end.
_ROUGH, _FINE = 1e-3, 1e-6
_ROBUST_ROUNDS, _REJECTION_ROUNDS = 6, 8
_REJECT_ANY, _REJECT_ALL = 5.0, 4.0
# Convergence: the relative change of the noise in the last round, and of a station over its sigma in the last step.
_SETTLED = 0.01
# The problem is nearly linear beside the minimum of plain least squares; less so where a station can slide along walls.
_SHAPE_STEPS = 16
# Shares of such a step that are tried.
_PARTS = 0.5 ** np.arange(5)
# Share by which the sum of squares may rise in such a step, by rounding.
_RISE = 1e-9


@dataclass(frozen=True)
class State:
    """An adjustment between its rounds; arrays as long as the observations, without padding."""

    prepared: Prepared
    observations: RoomObservations
    linearised: Linearised
    kept: Bool[np.ndarray, " points"]
    sighting_kept: Bool[np.ndarray, " sightings"]
    noise: Noise
    board_data: BoardData | None = None
    sighting_noise: float = 1.0
    """Noise of sightings over the given sigmas [1]."""
    heights: Float[np.ndarray, " sizes"] = field(default_factory=lambda: np.zeros(STOPS + 1))
    """Standard deviation of the heights of patches of each size [m], and of the table's stops [rad]."""
    stop_sigma: float = FIRST_STOP
    """Standard deviation of the stops at the images of features [rad]."""
    patched: Sequence[Wall] = ()
    """Walls whose patches are kept; without any, patches follow the places of the points."""
    boards: BoardEquations | None = None
    """The information of captured boards, at the scanner of a few steps before."""
    steps: int = 0
    converged: bool = False

    @property
    def y(self) -> Unknowns:
        return self.linearised.y

    @property
    def usable(self) -> Bool[np.ndarray, " points"]:
        """Points that are finite and whose rays meet the sheet; an error of 0 of the others is no observation."""
        return self.prepared.usable & np.asarray(self.linearised.points.meets)[: len(self.kept)]

    @property
    def surface(self) -> Int[np.ndarray, " points"]:
        return np.asarray(self.observations.points.surface)

    @property
    def error_px(self) -> Float[np.ndarray, " points"]:
        """Seen minus predicted centres [px]."""
        return np.asarray(self.linearised.points.rows.value)[: len(self.kept)]

    @property
    def reach(self) -> Float[np.ndarray, " points"]:
        """Size of the change of the distance from the surface by one pixel [m / px]."""
        return np.maximum(np.abs(np.asarray(self.linearised.points.reach)[: len(self.kept)]), 1e-7)

    @property
    def error(self) -> Float[np.ndarray, " points"]:
        """Distances from the surfaces [m]."""
        return self.error_px * np.asarray(self.linearised.points.reach)[: len(self.kept)]

    @property
    def given_px(self) -> Float[np.ndarray, " points"]:
        """Given standard deviations of the centres [px]; 1 where there is none."""
        return np.where(self.prepared.usable, self.observations.points.sigma, 1.0)

    @property
    def sigma_px(self) -> Float[np.ndarray, " points"]:
        """Standard deviation of the centres by noise and roughness [px]."""
        return self.noise.sigma(self.given_px, self.reach)

    def whitened(self) -> Float[np.ndarray, " points"]:
        """Errors over their standard deviations; 0 where there is none."""
        return np.where(self.usable, self.error_px / self.sigma_px, 0.0)

    def sighting_error(self) -> Float[np.ndarray, "sightings 2"]:
        """Projected minus seen [px]."""
        return np.asarray(self.linearised.sightings.value).reshape(-1, 2)[: len(self.sighting_kept)]

    def sighting_sigma(self) -> Float[np.ndarray, " sightings"]:
        """Given sigmas [px]; 1 where there is none."""
        tracks = self.observations.tracks
        given = np.zeros(0) if tracks is None else np.asarray(tracks.sigma)
        return np.where(self.prepared.seen, given, 1.0)

    def sighting_whitened(self) -> Float[np.ndarray, "sightings 2"]:
        """Errors of sightings over the given sigmas; 0 where there is none."""
        return np.where(self.prepared.seen[:, None], self.sighting_error() / self.sighting_sigma()[:, None], 0.0)

    @cached_property
    def walls(self) -> list[Wall]:
        """All walls and their patches."""
        points = self.observations.points
        stop = self.prepared.angles.first[points.sweep] + points.record
        return find_walls(self.prepared.room, self.linearised, self.kept, stop, self.patched)

    @cached_property
    def shaped(self) -> tuple[Arrow, float]:
        """Normal equations in which walls have a shape, and by how much that lowers the sum of squares."""
        arrow = self.linearised.arrow
        return with_shape(arrow, self.walls, self.heights) if self.heights.any() else (arrow, 0.0)

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of the unknowns, if this is the minimum."""
        return covariance_of(self.shaped[0])

    @property
    def cost(self) -> float:
        """Sum of squared whitened residuals with those of the prior, less the part that the shape of walls explains."""
        return self.linearised.cost - self.shaped[1]

    @property
    def misfit(self) -> float:
        """Mean square of the errors of kept points over their stated variance: no noise is learned here [1]."""
        if not self.kept.any():
            return 0.0
        square = (self.error_px / Noise(1.0, FIRST_WALL_M).sigma(self.given_px, self.reach)) ** 2
        return float(np.sum(square[self.kept]) / np.sum(self.redundancy()[self.kept]))

    @cached_property
    def plain_covariance(self) -> Covariance:
        """The same if all errors of points were independent."""
        return covariance_of(self.linearised.arrow)

    @property
    def inflation(self) -> float:
        """Mean factor of the variance of the scanner's numbers and the stations by errors that points share [1]."""
        count = len(self.y.scanner) + len(self.y.stations)
        plain = np.linalg.inv(self.plain_covariance.shared[:count, :count])
        return float(np.trace(plain @ self.covariance.shared[:count, :count])) / count

    @cached_property
    def _free(self) -> float:
        """Dense unknowns that the data determine rather than the priors."""
        count, others = len(self.y.scanner), len(self.y.stations)
        variance = np.diag(self.covariance.shared)
        free = float(np.sum(1.0 - np.clip(variance[:count], 0.0, 1.0))) + others
        if len(self.y.angles):
            room, rows = self.prepared.room, self.linearised.points.rows
            square = (np.asarray(rows.angle) * np.asarray(room.point_weight)) ** 2
            known = np.bincount(np.asarray(room.points.angle), square, len(self.y.angles))[: len(self.y.angles)]
            own = variance[count + others : count + others + len(known)]
            free += float(np.sum(np.minimum(own * known, 1.0)))
        return free

    def redundancy(self) -> Float[np.ndarray, " points"]:
        """Share of each error that the fit leaves [1]; the same for all points of a surface."""
        count = np.bincount(self.surface[self.kept], minlength=len(self.observations.surfaces.distance))
        every = max(int(self.kept.sum()), 1)
        return np.clip(1.0 - 3.0 / np.maximum(count, 1)[self.surface] - self._free / every, 0.05, 1.0)

    def learned_sighting_noise(self) -> float:
        """Noise of the kept sightings over the given sigmas [1]."""
        kept = self.sighting_kept
        if not kept.any():
            return 1.0
        tracks = self.observations.tracks
        points = len(np.unique(tracks.track[kept])) if tracks is not None else 0
        values = self.sighting_whitened()[kept].ravel()
        _, variance = self._stops
        taken = 3.0 * points + float(np.sum(1.0 - variance / max(self.stop_sigma, HELD_STOP) ** 2))
        return noise_component(values, np.full(len(values), min(taken / len(values), 0.9)))

    @property
    def _stops(self) -> tuple[Float[np.ndarray, " images"], Float[np.ndarray, " images"]]:
        """Corrections of the images of features [rad], and their variances if all errors of points are independent."""
        angles, begin = self.prepared.angles, len(self.y.scanner) + len(self.y.stations)
        seen = np.flatnonzero(np.bincount(angles.knot, minlength=angles.unknown)[: angles.unknown])
        variance = np.diag(self.plain_covariance.shared)[begin + seen]
        return ANGLE_SCALE * np.asarray(self.y.angles)[seen], ANGLE_SCALE**2 * variance

    def learned_stop_sigma(self) -> float:
        """Standard deviation of the stops at the images of features, by their corrections [rad]."""
        correction, variance = self._stops
        return learn_stops(correction, variance, max(self.stop_sigma, HELD_STOP)) if len(correction) else 0.0

    def weighted(self, points: np.ndarray | float, sightings: np.ndarray | float) -> Room:
        """The problem with weights by the present noise, damped by factors of points and sightings."""
        room = self.prepared.room
        point = np.zeros(len(room.point_weight))
        point[: len(self.kept)] = self.kept * points / self.sigma_px
        sighting = np.zeros(len(room.sighting_weight))
        sighting[: len(self.sighting_kept)] = (
            self.sighting_kept * sightings / (self.sighting_sigma() * self.sighting_noise)
        )
        stop = np.full(len(room.stop), 1.0 / max(self.stop_sigma, HELD_STOP))
        return eqx.tree_at(lambda r: (r.point_weight, r.sighting_weight, r.stop), room, (point, sighting, stop))


def adjust(
    prior: Scanner, start: Start, observations: RoomObservations, settings: RecalibrationSettings | None = None
) -> Adjusted:
    """Scanner, stations, surfaces and angles in one least squares of all observations and the stored calibration.

    Robust first; then outliers are rejected, the roughness of walls and the noise of stripes are learned from the
    residuals, and a plain least squares is the estimate of maximum likelihood. Runs in float64 whatever the caller's
    JAX settings. Parameters to which `prior` gives no variance are held.

    Raises:
        CalibrationError: If the stored calibration has no covariance, or the observations contradict each other.
    """
    settings = settings or RecalibrationSettings()
    with jax.enable_x64(True):
        prepared = prepare(prior, start, observations, settings)
        try:
            state = _robust(_begin(prepared, observations, settings, prior))
            state = _shaped(_reject(state, settings), settings)
        except np.linalg.LinAlgError as problem:
            raise CalibrationError(
                f"The captures contradict each other, so no adjustment fits them ({problem}): check that they are of "
                "this rig and of one room."
            ) from problem
        return _conclude(state, prior, observations)


def _begin(
    prepared: Prepared, observations: RoomObservations, settings: RecalibrationSettings, prior: Scanner
) -> State:
    linearised = linearise(prepared.room, prepared.y)
    data = None if observations.boards is None else prepare_boards(observations.boards, prior)
    noise, stop = Noise(1.0, FIRST_WALL_M), settings.angle_sigma or FIRST_STOP
    return State(
        prepared, observations, linearised, prepared.usable, prepared.seen, noise, board_data=data, stop_sigma=stop
    )


def _robust(state: State) -> State:
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
        state = _solved(_with_boards(state), _ROUGH, damp)
    return state


def _reject(state: State, settings: RecalibrationSettings) -> State:
    """Plain solves without outliers, with the noise that the residuals show."""
    limits = {"reject_any": _REJECT_ANY, "reject_all": _REJECT_ALL}
    state = replace(state, noise=_robust_noise_of(state))
    for round_number in range(_REJECTION_ROUNDS):
        usable, seen = state.usable, state.prepared.seen
        size = np.abs(state.whitened()) / np.sqrt(state.redundancy())
        kept = usable & keep_inliers(size, usable, state.kept, **limits)
        far = np.abs(state.sighting_whitened()).max(1, initial=0.0) / state.sighting_noise
        sightings = keep_inliers(far, seen, state.sighting_kept, **limits)
        cleaned = replace(state, kept=kept, sighting_kept=sightings)
        cleaned = replace(cleaned, noise=_learned_noise(cleaned))
        cleaned = _with_boards(replace(cleaned, sighting_noise=cleaned.learned_sighting_noise()))
        if settings.angle_sigma is None:
            cleaned = replace(cleaned, stop_sigma=cleaned.learned_stop_sigma())
        same = np.array_equal(kept, state.kept) and np.array_equal(sightings, state.sighting_kept)
        ratios = _ratios(cleaned, state)
        if round_number > 0 and same and max(abs(ratio - 1.0) for ratio in ratios) < _SETTLED:
            break
        state = _solved(cleaned, _FINE)
    return state


def _shaped(state: State, settings: RecalibrationSettings) -> State:
    """Generalised least squares, in which walls have a shape of the size that the residuals show."""
    if not state.kept.any():
        return state
    # Features tell the stops of the table better than walls do.
    stop_sigma = state.stop_sigma if state.prepared.angles.unknown else settings.angle_sigma
    heights = learn_heights(state.walls, state.plain_covariance, stop_sigma)
    if heights[STOPS]:
        # The noise of the points still contains the stops.
        state = replace(state, noise=_learned_noise(state, float(heights[STOPS])))
    # The roughness still contains the shape.
    wall = float(np.sqrt(max(state.noise.wall_m**2 - np.sum(heights[:STOPS] ** 2), 0.0)))
    # Errors that the shape explains would count twice, as errors that neighbouring profiles share.
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
        # Written so that NaN does not count as an improvement.
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
    return replace(state, prepared=prepared, linearised=linearise(prepared.room, y))


def _ratios(after: State, before: State) -> tuple[float, ...]:
    mean = lambda state: float(np.mean(state.sigma_px)) if len(state.kept) else 1.0
    return (
        mean(after) / mean(before),
        after.sighting_noise / before.sighting_noise,
        max(after.stop_sigma, HELD_STOP) / max(before.stop_sigma, HELD_STOP),
        # Boards look noisier from a scanner that does not fit them yet.
        *(_board_noise(after) / _board_noise(before)),
    )


def _board_noise(state: State) -> np.ndarray:
    """Noise of corners and of stripes, and how many stripe points share one error; empty without captured boards."""
    if state.boards is None:
        return np.zeros(0)
    result = state.boards.result
    return np.array([result.corner_noise, *result.stripe_noise, result.stripe_correlation])


def _learned_noise(state: State, stop_sigma: float = 0.0) -> Noise:
    """The noise of the kept points, without the part of the stops."""
    kept = state.kept
    unknown = np.asarray(state.prepared.room.points.angle) < len(state.y.angles)
    by_stop = np.where(unknown, 0.0, np.asarray(state.linearised.points.rows.angle) / ANGLE_SCALE)[: len(kept)]
    square = state.error_px[kept] ** 2 / state.redundancy()[kept] - (stop_sigma * by_stop[kept]) ** 2
    return learn_noise(square, state.given_px[kept], state.reach[kept])


def _robust_noise_of(state: State) -> Noise:
    """The noise by the median of the errors, since outliers are still in, with its learned proportions."""
    if not state.usable.any():
        return state.noise
    size = robust_noise(state.whitened()[state.usable])
    return Noise(state.noise.stripe, state.noise.wall_m * max(size, 0.1)) if size > 1 else state.noise


def _solved(state: State, tolerance: float, damp: tuple[np.ndarray | float, np.ndarray | float] = (1.0, 1.0)) -> State:
    """The state after one more solve, in which weights are damped by factors of the points and the sightings."""
    room = state.weighted(*damp)
    damping = _FIRST_DAMPING if state.steps == 0 else _NEAR_DAMPING
    found = solve(room, state.y, damping, tolerance, _MAX_STEPS)
    return replace(
        state,
        prepared=state.prepared._replace(room=room),
        linearised=found,
        steps=state.steps + found.steps,
        converged=found.converged,
    )


def _conclude(state: State, prior: Scanner, observations: RoomObservations) -> Adjusted:
    """The result of an adjustment; call in 64 bit."""
    room, y = state.prepared.room, state.y
    scanner, stations, _ = room.counts
    covariance = state.covariance.shared
    departure = np.asarray(room.root @ y.scanner)
    own = room.root @ covariance[:scanner, :scanner] @ room.root.T
    moved = prior.with_rig(state.linearised.rig)
    every = range(scanner, scanner + stations, 6)
    poses = [np.zeros((6, 6))] + [covariance[k : k + 6, k : k + 6] * STATION_SCALE**2 for k in every]
    rows = int(state.kept.sum()) + 2 * int(state.sighting_kept.sum()) + len(observations.lengths)
    tracks = observations.tracks
    used = len(np.unique(tracks.track[state.sighting_kept])) if tracks is not None else 0
    places = len(np.unique(state.surface[state.kept])) + used
    return Adjusted(
        scanner=eqx.tree_at(lambda s: s.covariance, moved, (own + own.T) / 2, is_leaf=lambda leaf: leaf is None),
        prior=prior,
        departure=departure,
        stations=np.asarray(state.linearised.stations),
        station_covariance=np.stack(poses),
        surfaces=_moved_surfaces(state, observations.surfaces),
        corrections=_corrections(state),
        point_error=state.error,
        point_sigma=state.sigma_px * state.reach,
        point_kept=state.kept,
        track_kept=state.sighting_kept,
        wall_m=state.noise.wall_m,
        inflation=state.inflation,
        observations=observations,
        cost=state.cost,
        freedom=rows - 3 * places - stations,
        converged=state.converged,
        steps=state.steps,
        uneven_m=float(np.sqrt(np.sum(state.heights[:STOPS] ** 2))),
        stop_sigma=float(state.heights[STOPS]) or (state.stop_sigma if state.prepared.angles.unknown else 0.0),
        misfit=state.misfit,
    )


def _moved_surfaces(state: State, surfaces: Surfaces) -> Surfaces:
    """The surfaces where the adjustment has them."""
    places, count = state.prepared.room.places, len(surfaces.distance)
    step = LOCAL_SCALE * state.y.locals[:count]
    normal = places.normal[:count] + np.einsum("sk,skc->sc", step[:, :2], places.basis[:count])
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    centre = np.asarray(places.centre[:count])
    away = places.offset[:count] + step[:, 2]
    return Surfaces(normal, (normal * centre).sum(1) + away, centre + away[:, None] * normal)


def _corrections(state: State) -> tuple[np.ndarray, ...]:
    angles = state.prepared.angles
    # Records without a correction have the number after the last one.
    correction = np.append(ANGLE_SCALE * state.y.angles, 0.0)[angles.knot]
    found = zip(angles.known, np.split(correction, angles.first[1:]), strict=True)
    return tuple(known + own for known, own in found)
