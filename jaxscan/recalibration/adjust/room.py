"""The joint problem: unknowns, observations and their weights, as arrays of few different sizes."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array, Rig, exponential


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
    """Unknown correction of its angle; 0 where there are none."""
    local: Int[Array, " points"]
    """Surface or track."""
    laser: Int[Array, " points"]


class Places(NamedTuple):
    """Surfaces and tracked points as they are before the step."""

    sphere: Bool[Array, " surfaces"]
    normal: Float[Array, "surfaces 3"]
    basis: Float[Array, "surfaces 2 3"]
    """Directions of a plane's tilts."""
    centre: Float[Array, "surfaces 3"]
    """Planes tilt about it."""
    offset: Float[Array, " surfaces"]
    """Of a plane from its centre along the normal, or the radius of a sphere [m]."""
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
    """Of its covariance: a step of the scanner is `root` times normal numbers."""
    told: Float[Array, "told params"]
    """More that is known of those numbers: rows of linear equations, each in standard deviations."""
    told_value: Float[Array, " told"]
    """Their right-hand sides."""
    stations: Float[Array, "stations 4 4"]
    smooth: Float[Array, " angles"]
    """1 / standard deviation of the step from each correction to the next [1 / rad]; 0 where anything may be."""
    held: Float[Array, "held angles"]
    """Combinations of corrections that the scanner's own numbers describe, each over its tolerance [1 / rad]."""
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
        return len(self.root), 6 * (len(self.stations) - 1), len(self.smooth)


class Unknowns(NamedTuple):
    """A step, in units of about one standard deviation."""

    scanner: Float[Array, " params"]
    stations: Float[Array, " stations_less_1_times_6"]
    """Six each but for the first: translation, rotation in its own frame."""
    angles: Float[Array, " angles"]
    locals: Float[Array, "locals 3"]
    """Surfaces, then tracked points."""


def moved_rig(room: Room, z: Float[Array, " params"]) -> Rig:
    """The rig after a step."""
    return room.rig.retract(room.root @ z)


def moved_station(station: Float[Array, "4 4"], step: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """A pose after a step in its own frame."""
    return station @ exponential(STATION_SCALE * step)


def moved_stations(room: Room, steps: Float[Array, " n"]) -> Float[Array, "stations 4 4"]:
    """The poses of all stations after a step."""
    return jax.vmap(moved_station)(room.stations, station_steps(steps))


def station_steps(steps: Float[Array, " n"]) -> Float[Array, "stations 6"]:
    """Six numbers for each station, zero for the first."""
    return jnp.concatenate([jnp.zeros((1, 6), steps.dtype), steps.reshape(-1, 6)])


def moved_normal(normal: Float[Array, "3"], basis: Float[Array, "2 3"], tilt: Float[Array, "2"]) -> Float[Array, "3"]:
    """A unit normal after two tilts [rad]."""
    turned = normal + tilt[0] * basis[0] + tilt[1] * basis[1]
    return turned / jnp.linalg.norm(turned)
