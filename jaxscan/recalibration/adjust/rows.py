"""Errors of points on surfaces and of sightings, and their derivatives by the few unknowns that each meets."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxscan.geometry import Array, Scanner, invert, transform
from jaxscan.recalibration.adjust.room import (
    ANGLE_SCALE,
    LOCAL_SCALE,
    Places,
    Room,
    Sight,
    Unknowns,
    moved_normal,
    moved_scanner,
    moved_station,
    station_steps,
)


class Rows(NamedTuple):
    """Errors and their derivatives by the scaled unknowns."""

    value: Float[Array, " rows"]
    scanner: Float[Array, "rows params"]
    station: Float[Array, "rows 6"]
    angle: Float[Array, " rows"]
    local: Float[Array, "rows 3"]
    across: Float[Array, " rows"]
    """Derivative by the pixel coordinate across the line [1 / px]."""


class Own(NamedTuple):
    """What one observation meets of the unknowns, and of the places."""

    station: Float[Array, "6"]
    angle: Float[Array, ""]
    local: Float[Array, "3"]


def room_point(
    scanner: Scanner, station: Float[Array, "4 4"], q: Float[Array, "2"], laser: Array, phi: Float[Array, ""]
) -> tuple[Float[Array, "3"], Bool[Array, ""]]:
    """Point of a stripe in the frame of the room, and whether the ray meets the sheet."""
    point, incidence = scanner.point(q, laser, phi)
    return transform(station, point), incidence > 0


def surface_distance(place: Places, step: Float[Array, "3"], point: Float[Array, "3"]) -> Float[Array, ""]:
    """Signed distance of a point from one surface after its step [m]."""
    size = LOCAL_SCALE * step
    normal = moved_normal(place.normal, place.basis, size[:2])
    away = point - place.centre
    beside = jnp.where(place.sphere, away - size, jnp.array([1.0, 0.0, 0.0], point.dtype))
    from_plane = jnp.dot(normal, away) - place.offset - size[2]
    return jnp.where(place.sphere, jnp.linalg.norm(beside) - place.offset, from_plane)


def point_rows(room: Room, y: Unknowns) -> Rows:
    """Distances of all points from their surfaces [m]."""
    sight, places = room.points, room.places._replace(point=room.places.normal)
    steps = station_steps(y.stations)

    def error(z, own: Own, q, sight: Sight, place: Places):
        pose = moved_station(room.stations[sight.station], own.station)
        phi = sight.phi + ANGLE_SCALE * own.angle
        point, meets = room_point(moved_scanner(room, z), pose, q, sight.laser, phi)
        return jnp.where(meets, surface_distance(place, own.local, point), 0.0)

    def one(sight: Sight):
        place = jax.tree.map(lambda leaf: leaf[sight.local], places)
        own = Own(steps[sight.station], _angle(y, sight), y.locals[sight.local])
        value, (z, own, q) = jax.value_and_grad(error, argnums=(0, 1, 2))(y.scanner, own, sight.q, sight, place)
        return Rows(value, z, own.station, own.angle, own.local, jnp.dot(q, room.across))

    return jax.vmap(one)(sight)


def places_in_surfaces(room: Room, y: Unknowns) -> Float[Array, "points 2"]:
    """Coordinates of all points in their planes [m]."""
    steps, scanner = station_steps(y.stations), moved_scanner(room, y.scanner)

    def one(sight: Sight):
        pose = moved_station(room.stations[sight.station], steps[sight.station])
        point, _ = room_point(scanner, pose, sight.q, sight.laser, sight.phi)
        return room.places.basis[sight.local] @ (point - room.places.centre[sight.local])

    return jax.vmap(one)(room.points)


def sighting_rows(room: Room, y: Unknowns) -> Rows:
    """Projected minus seen [px]: u and v of every sighting follow each other."""
    steps, surfaces = station_steps(y.stations), len(room.places.sphere)

    def error(z, own: Own, sight: Sight, point):
        scanner = moved_scanner(room, z)
        pose = moved_station(room.stations[sight.station], own.station)
        camera = pose @ scanner.pose(sight.phi + ANGLE_SCALE * own.angle)
        return scanner.camera.project(transform(invert(camera), point + LOCAL_SCALE * own.local)) - sight.q

    def one(sight: Sight):
        own = Own(steps[sight.station], _angle(y, sight), y.locals[surfaces + sight.local])
        point = room.places.point[sight.local]
        value = error(y.scanner, own, sight, point)
        z, own = jax.jacrev(error, argnums=(0, 1))(y.scanner, own, sight, point)
        return Rows(value, z, own.station, own.angle, own.local, jnp.zeros_like(value))

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
