"""The adjustment's normal equations by blocks, its solution by one compiled program, and where that ends.

Surfaces and tracked points are eliminated. Shared are the unknowns of scanner and stations, corrections of angles, and
the ends of known lengths.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array as JaxArray
from jaxtyping import Bool, Float, Int

from jaxscan.compiling import compile_sooner
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array, Rig
from jaxscan.leastsq import AbstractProblem, Arrow, Covariance, Linear
from jaxscan.leastsq import Unknowns as Step
from jaxscan.recalibration.adjust.room import (
    ANGLE_SCALE,
    PointRows,
    Residuals,
    Room,
    Rows,
    Sight,
    Unknowns,
    length_values,
    moved_rig,
    moved_stations,
    observe,
    twice,
)


def whitened(rows: Rows, weight: Float[Array, " rows"]) -> Rows:
    """Rows times their weights."""
    return Rows(*(field * (weight if field.ndim == 1 else weight[:, None]) for field in rows))


def form_blocks(room: Room, y: Unknowns, residual: Residuals, slopes: tuple[Rows, Rows]) -> Arrow:
    """J'J and J'r at a step, from the whitened derivatives of points and sightings."""
    scanner, stations, angles = room.counts
    surfaces, count = len(room.places.sphere), len(y.locals)
    dense = scanner + stations + angles
    double = Sight(*(twice(field) for field in room.sightings))
    double = double._replace(local=double.local + surfaces)
    blocks = _of_rows(slopes[0], residual.points, room.points, (room, count))
    if len(room.sighting_weight):
        more = _of_rows(slopes[1], residual.sightings, double, (room, count))
        blocks = jax.tree.map(jnp.add, blocks, more)
    prior = jnp.eye(scanner, dtype=blocks.shared.dtype) + room.told.T @ room.told
    matrix = jnp.asarray(blocks.shared).at[:scanner, :scanner].add(prior)
    gradient = jnp.asarray(blocks.shared_gradient).at[:scanner].add(residual.prior + room.told.T @ residual.told)
    if angles:
        tie, by_angle = _ties(room, residual)
        begin = scanner + stations
        matrix = matrix.at[begin:dense, begin:dense].add(tie)
        gradient = gradient.at[begin:dense].add(by_angle)
    blocks = blocks._replace(shared=matrix, shared_gradient=gradient)
    return _with_lengths(room, y, residual, blocks) if len(room.lengths.metres) else blocks


def _of_rows(rows: Rows, values: Array, sight: Sight, shapes: tuple[Room, int]) -> Arrow:
    room, count = shapes
    scanner, stations, angles = room.counts
    few, dense = scanner + stations, scanner + stations + angles
    # Each station has its own six columns; the first has none.
    own = jax.nn.one_hot(sight.station - 1, stations // 6, dtype=values.dtype)
    by_station = (own[:, :, None] * rows.station[:, None, :]).reshape(len(values), stations)
    by_few = jnp.concatenate([rows.scanner, by_station], axis=1)
    sums = lambda value: jnp.zeros((count, *value.shape[1:]), value.dtype).at[sight.local].add(value)
    cross = sums(by_few[:, :, None] * rows.local[:, None, :])
    local = sums(rows.local[:, :, None] * rows.local[:, None, :])
    matrix, gradient = by_few.T @ by_few, by_few.T @ values
    if angles:
        at_angle = lambda value: jnp.zeros((angles, *value.shape[1:]), value.dtype).at[sight.angle].add(value)
        both = at_angle(by_few * rows.angle[:, None])
        matrix = jnp.block([[matrix, both.T], [both, jnp.diag(at_angle(rows.angle**2))]])
        gradient = jnp.append(gradient, at_angle(rows.angle * values))
        wide = jnp.zeros((count, dense, 3), values.dtype).at[:, :few].set(cross)
        cross = wide.at[sight.local, few + sight.angle].add(rows.local * rows.angle[:, None])
    return Arrow(matrix, cross, local, gradient, sums(rows.local * values[:, None]))


def _ties(room: Room, residual: Residuals) -> tuple[Float[Array, "angles angles"], Float[Array, " angles"]]:
    """The priors of the corrections: small steps, and nothing that the scanner's own numbers describe."""
    size = ANGLE_SCALE * room.smooth
    squared, held = size**2, ANGLE_SCALE * room.held
    before = jnp.pad(size, (1, 0))[:-1]
    beside = jnp.diag(-squared[:-1], 1)
    matrix = jnp.diag(squared + before**2) + beside + beside.T + held.T @ held
    step = residual.smooth * size
    return matrix, jnp.pad(step, (1, 0))[:-1] - step + held.T @ residual.held


def _with_lengths(room: Room, y: Unknowns, residual: Residuals, blocks: Arrow) -> Arrow:
    """The ends of known lengths moved to the dense unknowns, since lengths tie them to each other."""
    ends = promoted(room)
    before, count = len(blocks.shared_gradient), len(ends)
    there = first_of_each(ends)
    keep = there[:, None, None].astype(blocks.local.dtype)
    cross, local = blocks.cross[ends] * keep, blocks.local[ends] * keep
    gradient = blocks.local_gradient[ends] * keep[:, 0]
    beside = jnp.swapaxes(cross, 0, 1).reshape(before, 3 * count)
    corner = jax.scipy.linalg.block_diag(*local)
    matrix = jnp.block([[blocks.shared, beside], [beside.T, corner]])
    slopes = jax.jacfwd(lambda locals: length_values(room, locals))(y.locals) * room.lengths.weight[:, None, None]
    slopes = (slopes[:, ends] * keep[None, :, 0]).reshape(-1, 3 * count)
    matrix = matrix.at[before:, before:].add(slopes.T @ slopes)
    by_ends = gradient.ravel() + slopes.T @ residual.lengths
    empty = jnp.asarray(blocks.cross).at[ends].set(0.0)
    return Arrow(
        matrix,
        jnp.concatenate([empty, jnp.zeros((len(empty), 3 * count, 3), empty.dtype)], axis=1),
        jnp.asarray(blocks.local).at[ends].set(0.0),
        jnp.append(blocks.shared_gradient, by_ends),
        jnp.asarray(blocks.local_gradient).at[ends].set(0.0),
    )


def promoted(room: Room) -> Array:
    """Surfaces and tracked points that known lengths end at; dense unknowns, three each."""
    return room.lengths.ends.ravel()


def first_of_each(index: Array) -> Array:
    """Which numbers of a list are not there before."""
    same = index[:, None] == index[None, :]
    return ~jnp.any(same & jnp.tril(jnp.ones_like(same), -1), axis=1)


def unknowns_of(room: Room, dense: Float[Array, " dense"], local: Float[Array, "locals 3"]) -> Unknowns:
    """The unknowns from those that are dense and the others; the ends of known lengths go to their places."""
    scanner, stations, angles = room.counts
    begin, end = scanner + stations, scanner + stations + angles
    ends = promoted(room)
    if len(ends):
        # The second slot of a place that has two is empty.
        local = jnp.asarray(local).at[ends].add(dense[end:].reshape(-1, 3))
    return Unknowns(dense[:scanner], dense[scanner:begin], dense[begin:end], local)


class Adjustment(AbstractProblem):
    """The room with its weights."""

    room: Room

    def linearise(self, y: Unknowns) -> tuple[Residuals, Linear]:
        """Derivatives are formed once per point, by the few unknowns that it meets."""
        room, observed = self.room, observe(y, self.room)
        slopes = (
            whitened(observed.points.rows, room.point_weight),
            whitened(observed.sightings, twice(room.sighting_weight)),
        )
        arrow = form_blocks(room, y, observed.residuals, slopes)
        return observed.residuals, Linear(arrow, (observed.points, observed.sightings))

    def move(self, y: Unknowns, step: Step) -> Unknowns:
        """Unknowns are themselves a step from the stored scanner, and are added to."""
        return jax.tree.map(jnp.add, y, unknowns_of(self.room, step.shared, step.local))


class Linearised(NamedTuple):
    """The problem to first order at a step."""

    points: PointRows
    sightings: Rows
    arrow: Arrow
    """The normal equations."""
    cost: Float[Array, ""]
    """Sum of squared whitened residuals, with those of the prior."""
    rig: Rig
    stations: Float[Array, "stations 4 4"]


class Solution(NamedTuple):
    """The end of a solve."""

    y: Unknowns
    linearised: Linearised
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


@compile_sooner
def _solved(room: Room, y: Unknowns, damping: JaxArray, tolerance: JaxArray, max_steps: JaxArray) -> Solution:
    # Imported by whoever solves: it takes its time.
    from jaxscan.leastsq.solver import minimise

    room, y = jax.tree.map(jnp.asarray, (room, y))
    found = minimise(Adjustment(room), y, damping, tolerance, max_steps)
    points, sightings = found.linear.more
    cost = jnp.asarray(sum(jnp.sum(part**2) for part in found.residuals))
    places = moved_rig(room, found.y.scanner), moved_stations(room, found.y.stations)
    end = Linearised(points, sightings, found.linear.arrow, cost, *places)
    return Solution(found.y, end, found.steps, found.converged)


def solve(room: Room, y: Unknowns, damping: float, tolerance: float, max_steps: int) -> Solution:
    """Minimise the sum of squares of all whitened residuals; call in 64 bit. On the host.

    Args:
        room: With its weights.
        y: Where to begin.
        damping: Of the first step, relative to the diagonal of J'J [1].
        tolerance: Root mean square change of unknowns and of whitened residuals at which to stop [1].
        max_steps: Evaluations at most.

    Raises:
        CalibrationError: If a number is not finite.
    """
    found = _solved(room, y, np.float64(damping), np.float64(tolerance), np.int32(max_steps))
    found = Solution(*jax.tree.map(np.asarray, tuple(found)))
    if not found.steps or not all(np.isfinite(part).all() for part in found.y):
        raise CalibrationError("The adjustment left the range of numbers: the captures contradict each other.")
    return found


def linearise(room: Room, y: Unknowns) -> Linearised:
    """Errors and information at a step; call in 64 bit."""
    return solve(room, y, 1.0, 1.0, 1).linearised


def step_of(room: Room, arrow: Arrow, covariance: Covariance) -> Unknowns:
    """The step of Gauss and Newton, (J'J)^-1 J'r; on the host."""
    return Unknowns(*jax.tree.map(np.asarray, tuple(unknowns_of(room, *covariance.step(arrow)))))
