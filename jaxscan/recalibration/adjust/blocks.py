"""The normal equations by blocks: surfaces and tracked points are eliminated, the rest is dense."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, Room, Sight, Unknowns
from jaxscan.recalibration.adjust.rows import Residuals, Rows, length_values, twice


class Blocks(NamedTuple):
    """J'J and J'r. Dense: scanner, stations, angles, and the ends of known lengths."""

    dense: Float[Array, "dense dense"]
    cross: Float[Array, "locals dense 3"]
    local: Float[Array, "locals 3 3"]
    dense_gradient: Float[Array, " dense"]
    local_gradient: Float[Array, "locals 3"]


def whitened(rows: Rows, weight: Float[Array, " rows"]) -> Rows:
    """Rows times their weights."""
    return Rows(*(field * (weight if field.ndim == 1 else weight[:, None]) for field in rows))


def columns(product: Callable[[Unknowns], Residuals], y: Unknowns) -> tuple[Rows, Rows]:
    """Whitened derivatives of points and sightings, by coloured forward mode.

    Args:
        product: Jacobian times a step.
        y: Any step, for its shapes.
    """
    scanner = len(y.scanner)
    # Behind the barrier, or the compiler works out products with these constants itself, slowly.
    unit = jax.lax.optimization_barrier(jnp.eye(scanner + 10, dtype=y.scanner.dtype))

    def product_with(e):
        # Every observation meets one station, one angle, one surface: all are moved at once.
        stations = jnp.tile(e[scanner : scanner + 6], len(y.stations) // 6)
        angles = jnp.broadcast_to(e[scanner + 6], y.angles.shape)
        locals = jnp.broadcast_to(e[None, scanner + 7 :], y.locals.shape)
        moved = product(Unknowns(e[:scanner], stations, angles, locals))
        return moved.points, moved.sightings

    def split(found):
        last = scanner + 6
        return Rows(found[0] * 0.0, found[:scanner].T, found[scanner:last].T, found[last], found[last + 1 :].T)

    points, sightings = jax.vmap(product_with)(unit)
    return split(points), split(sightings)


def form_blocks(room: Room, y: Unknowns, residual: Residuals, slopes: tuple[Rows, Rows]) -> Blocks:
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
    prior = jnp.eye(scanner, dtype=blocks.dense.dtype) + room.told.T @ room.told
    matrix = jnp.asarray(blocks.dense).at[:scanner, :scanner].add(prior)
    gradient = jnp.asarray(blocks.dense_gradient).at[:scanner].add(residual.prior + room.told.T @ residual.told)
    if angles:
        tie, by_angle = _ties(room, residual)
        begin = scanner + stations
        matrix = matrix.at[begin:dense, begin:dense].add(tie)
        gradient = gradient.at[begin:dense].add(by_angle)
    blocks = blocks._replace(dense=matrix, dense_gradient=gradient)
    return _with_lengths(room, y, residual, blocks) if len(room.lengths.metres) else blocks


def zero_blocks(y: Unknowns, lengths: int) -> Blocks:
    """Blocks of the right shapes."""
    dense = len(y.scanner) + len(y.stations) + len(y.angles) + 6 * lengths
    zeros = lambda *shape: jnp.zeros(shape, y.scanner.dtype)
    count = len(y.locals)
    return Blocks(zeros(dense, dense), zeros(count, dense, 3), zeros(count, 3, 3), zeros(dense), zeros(count, 3))


def _of_rows(rows: Rows, values: Array, sight: Sight, shapes: tuple[Room, int]) -> Blocks:
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
    return Blocks(matrix, cross, local, gradient, sums(rows.local * values[:, None]))


def _ties(room: Room, residual: Residuals) -> tuple[Float[Array, "angles angles"], Float[Array, " angles"]]:
    """The priors of the corrections: small steps, and nothing that the scanner's own numbers describe."""
    size = ANGLE_SCALE * room.smooth
    squared, held = size**2, ANGLE_SCALE * room.held
    before = jnp.pad(size, (1, 0))[:-1]
    beside = jnp.diag(-squared[:-1], 1)
    matrix = jnp.diag(squared + before**2) + beside + beside.T + held.T @ held
    step = residual.smooth * size
    return matrix, jnp.pad(step, (1, 0))[:-1] - step + held.T @ residual.held


def _with_lengths(room: Room, y: Unknowns, residual: Residuals, blocks: Blocks) -> Blocks:
    """The ends of known lengths moved to the dense unknowns, since lengths tie them to each other."""
    ends = promoted(room)
    before, count = len(blocks.dense_gradient), len(ends)
    there = first_of_each(ends)
    keep = there[:, None, None].astype(blocks.local.dtype)
    cross, local = blocks.cross[ends] * keep, blocks.local[ends] * keep
    gradient = blocks.local_gradient[ends] * keep[:, 0]
    beside = jnp.swapaxes(cross, 0, 1).reshape(before, 3 * count)
    corner = jax.scipy.linalg.block_diag(*local)
    matrix = jnp.block([[blocks.dense, beside], [beside.T, corner]])
    slopes = jax.jacfwd(lambda locals: length_values(room, locals))(y.locals) * room.lengths.weight[:, None, None]
    slopes = (slopes[:, ends] * keep[None, :, 0]).reshape(-1, 3 * count)
    matrix = matrix.at[before:, before:].add(slopes.T @ slopes)
    by_ends = gradient.ravel() + slopes.T @ residual.lengths
    empty = jnp.asarray(blocks.cross).at[ends].set(0.0)
    return Blocks(
        matrix,
        jnp.concatenate([empty, jnp.zeros((len(empty), 3 * count, 3), empty.dtype)], axis=1),
        jnp.asarray(blocks.local).at[ends].set(0.0),
        jnp.append(blocks.dense_gradient, by_ends),
        jnp.asarray(blocks.local_gradient).at[ends].set(0.0),
    )


def promoted(room: Room) -> Array:
    """Surfaces and tracked points that known lengths end at; dense unknowns, three each."""
    return room.lengths.ends.ravel()


def first_of_each(index: Array) -> Array:
    """Which numbers of a list are not there before."""
    same = index[:, None] == index[None, :]
    return ~jnp.any(same & jnp.tril(jnp.ones_like(same), -1), axis=1)


class Reduced(NamedTuple):
    """The normal equations of the dense unknowns alone."""

    matrix: Float[Array, "dense dense"]
    coupling: Float[Array, "locals 3 dense"]
    rhs: Float[Array, " dense"]
    local: Float[Array, "locals 3"]


def reduce_blocks(blocks: Blocks, damping: Float[Array, ""]) -> Reduced:
    """Eliminate surfaces and tracked points by Schur's complement, with `damping` relative to the diagonal."""
    factors = jax.vmap(lambda v: jnp.linalg.cholesky(v + jnp.diag(_damped(jnp.diag(v), damping))))(blocks.local)
    solve = jax.vmap(lambda factor, b: jax.scipy.linalg.cho_solve((factor, True), b))
    coupling = solve(factors, jnp.swapaxes(blocks.cross, 1, 2))
    local = solve(factors, blocks.local_gradient)
    count = len(blocks.dense_gradient)
    cross = jnp.swapaxes(blocks.cross, 1, 2).reshape(-1, count)
    matrix = blocks.dense + jnp.diag(_damped(jnp.diag(blocks.dense), damping)) - cross.T @ coupling.reshape(-1, count)
    return Reduced(matrix, coupling, blocks.dense_gradient - cross.T @ local.ravel(), local)


def solve_blocks(room: Room, y: Unknowns, blocks: Blocks, damping: Float[Array, ""]) -> Unknowns:
    """The step (J'J + damping diag(J'J))^-1 J'r."""
    reduced = reduce_blocks(blocks, damping)
    factor = jnp.linalg.cholesky(reduced.matrix)
    dense = jax.scipy.linalg.cho_solve((factor, True), reduced.rhs)
    return unknowns_of(room, dense, reduced.local - reduced.coupling @ dense)


def unknowns_of(room: Room, dense: Float[Array, " dense"], local: Float[Array, "locals 3"]) -> Unknowns:
    """The unknowns from those that are dense and the others; the ends of known lengths go to their places."""
    scanner, stations, angles = room.counts
    begin, end = scanner + stations, scanner + stations + angles
    ends = promoted(room)
    if len(ends):
        # The second slot of a place that has two is empty.
        local = jnp.asarray(local).at[ends].add(dense[end:].reshape(-1, 3))
    return Unknowns(dense[:scanner], dense[scanner:begin], dense[begin:end], local)


def _damped(diagonal: Float[Array, " n"], damping: Float[Array, ""]) -> Float[Array, " n"]:
    # Held unknowns and padding have empty columns; a 1 keeps the matrix regular and their step 0.
    return jnp.where(diagonal > 0, damping * diagonal, 1.0).astype(diagonal.dtype)
