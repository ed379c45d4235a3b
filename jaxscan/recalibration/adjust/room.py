"""The joint problem: unknowns, observations and weights as arrays; residuals, derivatives and normal equations.

Surfaces and tracked points are eliminated. Shared are the unknowns of scanner and stations, corrections of angles, and
the ends of known lengths.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array, Rig, exponential, invert, lit_points, pixels, poses, transform
from jaxscan.leastsq import AbstractProblem, Arrow, Covariance, Linear, minimised
from jaxscan.leastsq import Unknowns as Step


STATION_SCALE = 1e-3
"""Unit of a station's step [m, rad]."""
ANGLE_SCALE = 1e-4
"""Unit of a correction of an angle [rad]."""
LOCAL_SCALE = 1e-3
"""Unit of the unknowns of surfaces and points [m; rad for the tilts of a plane]."""


class Sight(NamedTuple):
    """Where and from where something is seen; leads with the axis of the points."""

    q: Float[Array, "points 2"]
    phi: Float[Array, " points"]
    """The table's angle with known faults corrected [rad from home]."""
    station: Int[Array, " points"]
    angle: Int[Array, " points"]
    """Unknown correction of its angle; where it has none, the number of all."""
    local: Int[Array, " points"]
    """Surface or track."""
    laser: Int[Array, " points"]


class Places(NamedTuple):
    """Flat surfaces and tracked points as they are before the step."""

    normal: Float[Array, "surfaces 3"]
    basis: Float[Array, "surfaces 2 3"]
    """Directions of a plane's tilts."""
    centre: Float[Array, "surfaces 3"]
    """Planes tilt about it."""
    offset: Float[Array, " surfaces"]
    """Distance of the plane from the centre along the normal [m]."""
    point: Float[Array, "tracks 3"]


class Lengths(NamedTuple):
    """Known lengths between two surfaces or two tracked points."""

    ends: Int[Array, "lengths 2"]
    """Numbers of the two among surfaces, then tracks."""
    metres: Float[Array, " lengths"]
    weight: Float[Array, " lengths"]
    """1 / sigma [1 / m]."""


class Room(eqx.Module):
    """Observations, weights, and the point from which steps are counted; all padding has weight 0.

    A weight is 1 over the standard deviation that the residual is divided by.
    """

    rig: Rig
    """The stored one, from which the step of the scanner is counted."""
    root: Float[Array, "params params"]
    """Square root of its covariance: a step of the scanner is `root` times normal numbers."""
    linear_rows: Float[Array, "rows params"]
    """Further knowledge of those numbers, such as from boards: rows of linear equations, each in standard
    deviations."""
    linear_values: Float[Array, " rows"]
    """Their right-hand sides."""
    stations: Float[Array, "stations 4 4"]
    stop: Float[Array, " angles"]
    """1 / standard deviation of each correction of an angle [1 / rad]."""
    places: Places
    points: Sight
    point_weight: Float[Array, " points"]
    across: Float[Array, "2"]
    """Direction across a line, in the image."""
    sightings: Sight
    sighting_weight: Float[Array, " sightings"]
    lengths: Lengths

    @property
    def counts(self) -> tuple[int, int, int]:
        """Dense unknowns: of the scanner, of the stations, corrections of angles."""
        return len(self.root), 6 * (len(self.stations) - 1), len(self.stop)


class Unknowns(NamedTuple):
    """A step, in units of about one standard deviation."""

    scanner: Float[Array, " params"]
    stations: Float[Array, " stations_less_1_times_6"]
    """Six for each station except the first: translation and rotation in its own frame."""
    angles: Float[Array, " angles"]
    locals: Float[Array, "locals 3"]
    """Surfaces, then tracked points."""


def moved_rig(room: Room, z: Float[Array, " params"]) -> Rig:
    """The rig after a step."""
    return room.rig.retract(room.root @ z)


def moved_station(station: Float[Array, "4 4"], step: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """A pose after a step in its own frame."""
    return station @ exponential(STATION_SCALE * step)


def moved_stations(room: Room, steps: Float[Array, " n"]) -> Float[np.ndarray, "stations 4 4"]:
    """The poses of all stations after a step; on the host."""
    each = np.concatenate([np.zeros((1, 6)), np.reshape(steps, (-1, 6))])
    return np.asarray(room.stations) @ exponential(STATION_SCALE * each)


def station_steps(steps: Float[Array, " n"]) -> Float[Array, "stations 6"]:
    """Six numbers for each station, zero for the first."""
    return jnp.concatenate([jnp.zeros((1, 6), steps.dtype), steps.reshape(-1, 6)])


def moved_normal(normal: Float[Array, "3"], basis: Float[Array, "2 3"], tilt: Float[Array, "2"]) -> Float[Array, "3"]:
    """A unit normal after two tilts [rad]."""
    turned = normal + tilt[0] * basis[0] + tilt[1] * basis[1]
    return turned / jnp.linalg.norm(turned)


_NEWTON_STEPS = 2
# A predicted centre is sought within this of the seen one [px].
_FARTHEST_PX = 20.0
_LEAST_REACH = 1e-7


class Rows(NamedTuple):
    """Residuals [px] and their derivatives by the scaled unknowns that each meets."""

    value: Float[Array, " rows"]
    scanner: Float[Array, "rows params"]
    station: Float[Array, "rows 6"]
    angle: Float[Array, " rows"]
    local: Float[Array, "rows 3"]


class PointRows(NamedTuple):
    """Residuals of points on surfaces, with the geometry behind them."""

    rows: Rows
    reach: Float[Array, " points"]
    """Change of the distance from the surface by one pixel across the line [m / px]."""
    place: Float[Array, "points 2"]
    """Coordinates in the plane [m]."""
    meets: Bool[Array, " points"]
    """Whether the ray meets the sheet; where it does not, there is neither an error nor a slope."""


class Own(NamedTuple):
    """The unknowns, and the places, that one observation depends on."""

    station: Float[Array, "6"]
    angle: Float[Array, ""]
    local: Float[Array, "3"]


def room_point(
    rig: Rig, station: Float[Array, "4 4"], q: Float[Array, "2"], laser: Array, phi: Float[Array, ""]
) -> tuple[Float[Array, "3"], Bool[Array, ""]]:
    """Point of a stripe in the frame of the room, and whether the ray meets the sheet."""
    p_cam, incidence = lit_points(rig, q, laser)
    return transform(station, transform(poses(rig, phi), p_cam)), incidence > 0


def surface_distance(place: Places, step: Float[Array, "3"], point: Float[Array, "3"]) -> Float[Array, ""]:
    """Signed distance of a point from one surface after its step [m]."""
    size = LOCAL_SCALE * step
    normal = moved_normal(place.normal, place.basis, size[:2])
    return jnp.dot(normal, point - place.centre) - place.offset - size[2]


def point_rows(room: Room, y: Unknowns) -> PointRows:
    r"""Seen minus predicted centres of all points [px].

    The predicted centre is where the stripe's ray meets the surface: the root of $e(u) = 0$ with e the distance of the
    triangulated point. Its derivatives are $-e_x / e_u$ there. A distance over its standard deviation would not do: the
    size of the room is one of the two numbers that planes leave open, and a smaller room has smaller distances.
    """
    steps, places = station_steps(y.stations), room.places._replace(point=room.places.normal)

    def error(z, own: Own, shift, sight: Sight, place: Places):
        pose = moved_station(room.stations[sight.station], own.station)
        q, phi = sight.q + shift * room.across, sight.phi + ANGLE_SCALE * own.angle
        point, meets = room_point(moved_rig(room, z), pose, q, sight.laser, phi)
        distance = jnp.where(meets, surface_distance(place, own.local, point), 0.0)
        return distance, (place.basis @ (point - place.centre), meets)

    def one(sight: Sight):
        place = jax.tree.map(lambda leaf: leaf[sight.local], places)
        own = Own(steps[sight.station], _angle(y, sight), y.locals[sight.local])
        across = lambda shift: error(y.scanner, own, shift, sight, place)[0]

        def newton(_, shift):
            distance, reach = jax.jvp(across, (shift,), (jnp.ones_like(shift),))
            return jnp.clip(shift - distance / _some(reach), -_FARTHEST_PX, _FARTHEST_PX)

        shift = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.zeros_like(sight.phi))
        by = jax.value_and_grad(error, argnums=(0, 1, 2), has_aux=True)
        (distance, (at, meets)), (z, own, reach) = by(y.scanner, own, shift, sight, place)
        one_px = _some(reach)
        value = distance / one_px - shift
        return PointRows(
            Rows(value, z / one_px, own.station / one_px, own.angle / one_px, own.local / one_px), reach, at, meets
        )

    return jax.vmap(one)(room.points)


def _some(reach: Float[Array, ""]) -> Float[Array, ""]:
    """Never 0, so that a ray along a wall gives no NaN; the weight of such a point is nearly 0."""
    return jnp.where(jnp.abs(reach) < _LEAST_REACH, _LEAST_REACH, reach).astype(reach.dtype)


def sighting_rows(room: Room, y: Unknowns) -> Rows:
    """Projected minus seen [px]: u and v of every sighting follow each other."""
    if not len(room.sighting_weight):
        none = jnp.zeros(0, y.scanner.dtype)
        few = jnp.zeros((0, 6), none.dtype)
        return Rows(none, jnp.zeros((0, len(y.scanner)), none.dtype), few, none, few[:, :3])
    steps, surfaces = station_steps(y.stations), len(room.places.offset)

    def error(z, own: Own, sight: Sight, point):
        pose = moved_station(room.stations[sight.station], own.station)
        p = transform(invert(pose), point + LOCAL_SCALE * own.local)
        return pixels(moved_rig(room, z), p, sight.phi + ANGLE_SCALE * own.angle) - sight.q

    def one(sight: Sight):
        own = Own(steps[sight.station], _angle(y, sight), y.locals[surfaces + sight.local])
        point = room.places.point[sight.local]
        value = error(y.scanner, own, sight, point)
        z, own = jax.jacrev(error, argnums=(0, 1))(y.scanner, own, sight, point)
        return Rows(value, z, own.station, own.angle, own.local)

    rows = jax.vmap(one)(room.sightings)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), rows)


def _angle(y: Unknowns, sight: Sight) -> Float[Array, ""]:
    # JAX takes nothing from an array that is empty, not even what fills it.
    if not len(y.angles):
        return jnp.zeros_like(sight.phi)
    return jnp.asarray(y.angles).at[sight.angle].get(mode="fill", fill_value=0.0)


def length_values(room: Room, locals: Float[Array, "locals 3"]) -> Float[Array, " lengths"]:
    """Lengths as they are, less those that are known [m]."""
    surfaces, places = len(room.places.offset), room.places

    def plane(index):
        step = LOCAL_SCALE * locals[index]
        normal = moved_normal(places.normal[index], places.basis[index], step[:2])
        # A point of the plane: planes tilt about their centres.
        return normal, normal @ places.centre[index] + places.offset[index] + step[2]

    def between_planes(first, second):
        (a, at_a), (b, at_b) = plane(first), plane(second)
        # Opposite walls face each other.
        sign = jnp.where(jnp.dot(a, b) < 0, -1.0, 1.0)
        mean = a + sign * b
        mean = mean / jnp.linalg.norm(mean)
        middle = (places.centre[first] + places.centre[second]) / 2
        along = lambda n, at: (at - jnp.dot(n, middle)) / jnp.dot(n, mean)
        return jnp.abs(along(a, at_a) - along(sign * b, sign * at_b))

    def between_points(first, second):
        where = jnp.concatenate([places.centre, places.point]) + LOCAL_SCALE * locals
        return jnp.linalg.norm(where[first] - where[second])

    def one(ends, metres):
        first, second = ends[0], ends[1]
        planes = between_planes(first % surfaces, second % surfaces)
        return jnp.where(first >= surfaces, between_points(first, second), planes) - metres

    return jax.vmap(one)(room.lengths.ends, room.lengths.metres)


class Residuals(NamedTuple):
    """All residuals, each in standard deviations."""

    points: Float[Array, " points"]
    sightings: Float[Array, " rows"]
    lengths: Float[Array, " lengths"]
    prior: Float[Array, " params"]
    linear: Float[Array, " rows"]
    stops: Float[Array, " angles"]


def twice(values: Array) -> Array:
    """Every number two times in a row: for u and for v."""
    return jnp.repeat(values, 2, total_repeat_length=2 * len(values))


def form_blocks(room: Room, y: Unknowns, residual: Residuals, points: Rows, sightings: Rows) -> Arrow:
    """J'J and J'r at a step, from the derivatives of points and sightings."""
    scanner, stations, angles = room.counts
    surfaces, count = len(room.places.offset), len(y.locals)
    dense = scanner + stations + angles
    double = Sight(*(twice(field) for field in room.sightings))
    double = double._replace(local=double.local + surfaces)
    blocks = _of_rows(points, room.point_weight, residual.points, room.points, room, count)
    if len(room.sighting_weight):
        more = _of_rows(sightings, twice(room.sighting_weight), residual.sightings, double, room, count)
        blocks = jax.tree.map(jnp.add, blocks, more)
    prior = jnp.eye(scanner, dtype=blocks.shared.dtype) + room.linear_rows.T @ room.linear_rows
    matrix = jnp.asarray(blocks.shared).at[:scanner, :scanner].add(prior)
    gradient = (
        jnp.asarray(blocks.shared_gradient).at[:scanner].add(residual.prior + room.linear_rows.T @ residual.linear)
    )
    if angles:
        stop = ANGLE_SCALE * room.stop
        begin = scanner + stations
        matrix = matrix.at[begin:dense, begin:dense].add(jnp.diag(stop**2))
        gradient = gradient.at[begin:dense].add(stop * residual.stops)
    blocks = blocks._replace(shared=matrix, shared_gradient=gradient)
    return _with_lengths(room, y, residual, blocks) if len(room.lengths.metres) else blocks


def _of_rows(rows: Rows, weight: Array, values: Array, sight: Sight, room: Room, count: int) -> Arrow:
    """The part of points or of sightings, by their rows, weights and whitened residuals."""
    rows = Rows(*(field * (weight if field.ndim == 1 else weight[:, None]) for field in rows))
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
        # Observations whose angle has no correction have a number out of range, and are left out.
        at_angle = lambda value: jnp.zeros((angles, *value.shape[1:]), value.dtype).at[sight.angle].add(value)
        both = at_angle(by_few * rows.angle[:, None])
        matrix = jnp.block([[matrix, both.T], [both, jnp.diag(at_angle(rows.angle**2))]])
        gradient = jnp.append(gradient, at_angle(rows.angle * values))
        wide = jnp.zeros((count, dense, 3), values.dtype).at[:, :few].set(cross)
        cross = wide.at[sight.local, few + sight.angle].add(rows.local * rows.angle[:, None])
    return Arrow(matrix, cross, local, gradient, sums(rows.local * values[:, None]))


def _with_lengths(room: Room, y: Unknowns, residual: Residuals, blocks: Arrow) -> Arrow:
    """The ends of known lengths moved to the dense unknowns, since lengths tie them to each other."""
    ends = room.lengths.ends.ravel()
    before, count = len(blocks.shared_gradient), len(ends)
    # A place at which two lengths end has the unknowns of the first.
    same = ends[:, None] == ends[None, :]
    first = ~jnp.any(same & jnp.tril(jnp.ones_like(same), -1), axis=1)
    keep = first[:, None, None].astype(blocks.local.dtype)
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


def unknowns_of(room: Room, dense: Float[Array, " dense"], local: Float[Array, "locals 3"]) -> Unknowns:
    """The unknowns from those that are dense and the others; the ends of known lengths go to their places."""
    scanner, stations, angles = room.counts
    begin, end = scanner + stations, scanner + stations + angles
    ends = room.lengths.ends.ravel()
    if len(ends):
        # The second slot of a place that has two is empty.
        local = jnp.asarray(local).at[ends].add(dense[end:].reshape(-1, 3))
    return Unknowns(dense[:scanner], dense[scanner:begin], dense[begin:end], local)


class Adjustment(AbstractProblem):
    """The room with its weights."""

    room: Room

    def linearise(self, y: Unknowns) -> tuple[Residuals, Linear]:
        """Derivatives are formed once per point, by the few unknowns that it meets."""
        room = self.room
        points, sightings = point_rows(room, y), sighting_rows(room, y)
        residuals = Residuals(
            points.rows.value * room.point_weight,
            sightings.value * twice(room.sighting_weight),
            length_values(room, y.locals) * room.lengths.weight,
            y.scanner,
            room.linear_rows @ y.scanner - room.linear_values,
            ANGLE_SCALE * y.angles * room.stop,
        )
        return residuals, Linear(form_blocks(room, y, residuals, points.rows, sightings), (points, sightings))

    def move(self, y: Unknowns, step: Step) -> Unknowns:
        """Unknowns are themselves a step from the stored scanner, and are added to."""
        return jax.tree.map(jnp.add, y, unknowns_of(self.room, step.shared, step.local))


class Linearised(NamedTuple):
    """The problem to first order where a solve ended; on the host."""

    y: Unknowns
    points: PointRows
    sightings: Rows
    arrow: Arrow
    cost: float
    """Sum of squared whitened residuals, with those of the prior."""
    rig: Rig
    stations: Float[Array, "stations 4 4"]
    steps: int
    converged: bool


def solve(room: Room, y: Unknowns, damping: float, tolerance: float, max_steps: int) -> Linearised:
    """Minimise the sum of squares of all whitened residuals, as `minimised` of `leastsq`; call in 64 bit.

    Raises:
        CalibrationError: If a number is not finite.
    """
    found = minimised(Adjustment(room), y, damping, tolerance, max_steps)
    if not found.steps or not all(np.isfinite(part).all() for part in found.y):
        raise CalibrationError("The adjustment left the range of numbers: the captures contradict each other.")
    cost = sum(float(np.sum(part**2)) for part in found.residuals)
    points, sightings = found.linear.more
    rig, stations = moved_rig(room, found.y.scanner), moved_stations(room, found.y.stations)
    linear = found.y, points, sightings, found.linear.arrow, cost
    return Linearised(*linear, rig, stations, int(found.steps), bool(found.converged))


def linearise(room: Room, y: Unknowns) -> Linearised:
    """The problem to first order at a step; call in 64 bit."""
    return solve(room, y, 1.0, 1.0, 1)


def step_of(room: Room, arrow: Arrow, covariance: Covariance) -> Unknowns:
    """The step of Gauss and Newton, (J'J)^-1 J'r; on the host."""
    return Unknowns(*jax.tree.map(np.asarray, tuple(unknowns_of(room, *covariance.step(arrow)))))
