"""Knowledge that a user gives beside the sweeps: places of stations, known lengths, spheres, tracks, boards."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.observation import Observations
from jaxscan.recalibration.observed import Tracks


Place = str | Float[np.ndarray, "3"]
"""The name of a target among the tracks, or a point on a plane or near the middle of a sphere, in the frame of the
room as the stored calibration has it [m]."""


class MeasuredLength(NamedTuple):
    """A length that somebody measured, by the places of its ends."""

    metres: float
    sigma_m: float
    first: Place
    second: Place
    name: str = ""
    """For messages."""


class KnownSphere(NamedTuple):
    """A sphere that stands in the room."""

    near: Float[np.ndarray, "3"]
    """Its middle, roughly, in the frame of the room [m]."""
    diameter_m: float
    sweep: int | None = None
    """The sweep that sees it; None: all of them are searched."""


@dataclass(frozen=True)
class Given:
    """All that is known of the room beside its sweeps; everything may be absent."""

    stations: Float[np.ndarray, "stations 4 4"] | None = None
    """First poses T_room_scanner, the identity first; None: they are found from planes and targets."""
    tracks: Tracks | None = None
    lengths: tuple[MeasuredLength, ...] = ()
    spheres: tuple[KnownSphere, ...] = ()
    boards: Observations | None = None
    """Boards captured with the rig as it is now."""
