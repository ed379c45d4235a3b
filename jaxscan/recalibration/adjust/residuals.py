"""The whitened residuals of the joint problem."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, Room, Sight, Unknowns, station_steps
from jaxscan.recalibration.adjust.rows import PointRows, Rows, length_values, point_rows, sighting_rows


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
    """Residuals at a step, and what they are made of."""

    residuals: Residuals
    points: PointRows
    sightings: Rows


def residuals(y: Unknowns, room: Room) -> Residuals:
    """Residuals of a step; their derivatives are formed once per point, and are linear in what the point meets."""
    return observe(y, room).residuals


def observe(y: Unknowns, room: Room) -> Observed:
    """Residuals of a step, with their rows."""
    fixed = jax.lax.stop_gradient(y)
    away = jax.tree.map(jnp.subtract, y, fixed)
    points, sightings = jax.lax.stop_gradient((point_rows(room, fixed), sighting_rows(room, fixed)))
    of_points = _linear(points.rows, away, room.points, 0, 1)
    of_sightings = _linear(sightings, away, room.sightings, len(room.places.sphere), 2)
    steps, held = angle_residuals(room, y.angles)
    whitened = Residuals(
        of_points * room.point_weight,
        of_sightings * twice(room.sighting_weight),
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
    """Steps between neighbouring corrections, and what the scanner's own numbers describe of them."""
    size = ANGLE_SCALE * angles
    return (jnp.append(size[1:], size[-1:]) - size) * room.smooth, room.held @ size


def _linear(rows: Rows, away: Unknowns, sight: Sight, first: int, each: int) -> Float[Array, " rows"]:
    station, local, angle = (
        field if each == 1 else twice(field) for field in (sight.station, sight.local, sight.angle)
    )
    value = rows.value + rows.scanner @ away.scanner
    value = value + jnp.sum(rows.station * station_steps(away.stations)[station], axis=1)
    value = value + jnp.sum(rows.local * away.locals[first + local], axis=1)
    return value + rows.angle * away.angles[angle] if len(away.angles) else value
