"""The normal equations by blocks: surfaces and tracked points are eliminated, the rest is shared.

Shared are the unknowns of scanner and stations, corrections of angles, and the ends of known lengths.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.leastsq import Arrow
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, Room, Sight, Unknowns
from jaxscan.recalibration.adjust.rows import Residuals, Rows, length_values, twice


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
