"""The whitened residuals of the joint problem."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, Room, Sight, Unknowns, station_steps
from jaxscan.recalibration.adjust.rows import Rows, length_values, point_rows, sighting_rows


class Residuals(NamedTuple):
    """All residuals, each in standard deviations."""

    points: Float[Array, " points"]
    sightings: Float[Array, " rows"]
    lengths: Float[Array, " lengths"]
    prior: Float[Array, " params"]
    told: Float[Array, " told"]
    smooth: Float[Array, " angles"]
    held: Float[Array, " held"]


def residuals(y: Unknowns, room: Room) -> Residuals:
    """Residuals of a step; their derivatives are formed once per point, and are linear in what the point meets."""
    fixed = jax.lax.stop_gradient(y)
    away = jax.tree.map(jnp.subtract, y, fixed)
    points, sightings = jax.lax.stop_gradient((point_rows(room, fixed), sighting_rows(room, fixed)))
    surfaces = len(room.places.sphere)
    of_points = _linear(points, away, room.points, 0, 1)
    of_sightings = _linear(sightings, away, room.sightings, surfaces, 2)
    steps, held = angle_residuals(room, y.angles)
    return Residuals(
        of_points * room.point_weight,
        of_sightings * jnp.repeat(room.sighting_weight, 2, total_repeat_length=len(of_sightings)),
        length_values(room, y.locals) * room.lengths.weight,
        y.scanner,
        room.told @ y.scanner - room.told_value,
        steps,
        held,
    )


def angle_residuals(room: Room, angles: Float[Array, " angles"]) -> tuple[Array, Array]:
    """Steps between neighbouring corrections, and what the scanner's own numbers describe of them."""
    size = ANGLE_SCALE * angles
    return (jnp.append(size[1:], size[-1:]) - size) * room.smooth, room.held @ size


def _linear(rows: Rows, away: Unknowns, sight: Sight, first: int, each: int) -> Float[Array, " rows"]:
    repeat = lambda index: jnp.repeat(index, each, total_repeat_length=len(rows.value))
    value = rows.value + rows.scanner @ away.scanner
    value = value + jnp.sum(rows.station * station_steps(away.stations)[repeat(sight.station)], axis=1)
    value = value + jnp.sum(rows.local * away.locals[first + repeat(sight.local)], axis=1)
    return value + rows.angle * away.angles[repeat(sight.angle)] if len(away.angles) else value
