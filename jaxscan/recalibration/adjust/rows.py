"""Residuals of the joint problem, and their derivatives by the few unknowns that each point meets."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxscan.geometry import Array, Rig, invert, lit_points, pixels, poses, transform
from jaxscan.recalibration.adjust.room import (
    ANGLE_SCALE,
    LOCAL_SCALE,
    Places,
    Room,
    Sight,
    Unknowns,
    moved_normal,
    moved_rig,
    moved_station,
    station_steps,
)


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
    """Of points on surfaces."""

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
    away = point - place.centre
    beside = jnp.where(place.sphere, away - size, jnp.array([1.0, 0.0, 0.0], point.dtype))
    from_plane = jnp.dot(normal, away) - place.offset - size[2]
    return jnp.where(place.sphere, jnp.linalg.norm(beside) - place.offset, from_plane)


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
    """Never 0, so that a ray along a wall makes no NaN; its weight is next to none."""
    return jnp.where(jnp.abs(reach) < _LEAST_REACH, _LEAST_REACH, reach).astype(reach.dtype)


def sighting_rows(room: Room, y: Unknowns) -> Rows:
    """Projected minus seen [px]: u and v of every sighting follow each other."""
    if not len(room.sighting_weight):
        none = jnp.zeros(0, y.scanner.dtype)
        few = jnp.zeros((0, 6), none.dtype)
        return Rows(none, jnp.zeros((0, len(y.scanner)), none.dtype), few, none, few[:, :3])
    steps, surfaces = station_steps(y.stations), len(room.places.sphere)

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
    return y.angles[sight.angle] if len(y.angles) else jnp.zeros_like(sight.phi)


def length_values(room: Room, locals: Float[Array, "locals 3"]) -> Float[Array, " lengths"]:
    """Lengths as they are, less those that are known [m]."""
    surfaces, places = len(room.places.sphere), room.places

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
        kind = jnp.concatenate([places.sphere, jnp.ones(len(places.point), bool)])
        first, second = ends[0], ends[1]
        planes = between_planes(first % surfaces, second % surfaces)
        return jnp.where(kind[first] & kind[second], between_points(first, second), planes) - metres

    return jax.vmap(one)(room.lengths.ends, room.lengths.metres)


class Residuals(NamedTuple):
    """All residuals, each in standard deviations."""

    points: Float[Array, " points"]
    sightings: Float[Array, " rows"]
    lengths: Float[Array, " lengths"]
    prior: Float[Array, " params"]
    told: Float[Array, " told"]
    smooth: Float[Array, " angles"]
    held: Float[Array, " held"]


class Observed(NamedTuple):
    """Residuals at a step, and the rows they are made of."""

    residuals: Residuals
    points: PointRows
    sightings: Rows


def observe(y: Unknowns, room: Room) -> Observed:
    """Residuals of a step, with their rows."""
    points, sightings = point_rows(room, y), sighting_rows(room, y)
    steps, held = angle_residuals(room, y.angles)
    whitened = Residuals(
        points.rows.value * room.point_weight,
        sightings.value * twice(room.sighting_weight),
        length_values(room, y.locals) * room.lengths.weight,
        y.scanner,
        room.told @ y.scanner - room.told_value,
        steps,
        held,
    )
    return Observed(whitened, points, sightings)


def twice(values: Array) -> Array:
    """Every number two times in a row: for u and for v."""
    return jnp.repeat(values, 2, total_repeat_length=2 * len(values))


def angle_residuals(room: Room, angles: Float[Array, " angles"]) -> tuple[Array, Array]:
    """Steps between neighbouring corrections, and the part of them that the scanner's own numbers describe."""
    size = ANGLE_SCALE * angles
    return (jnp.append(size[1:], size[-1:]) - size) * room.smooth, room.held @ size
