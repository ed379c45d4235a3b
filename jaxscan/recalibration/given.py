"""All that a user gives beside sweeps: how to recalibrate, and what is known of the room."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.observation import Observations
from jaxscan.recalibration.observed import Tracks
from jaxscan.reconstruction import ReconstructSettings


@dataclass(frozen=True)
class RecalibrationSettings:
    """How sweeps refine a stored calibration."""

    stations: bool = False
    """Whether every sweep was taken from a place of its own."""
    stripes: ReconstructSettings = field(default_factory=ReconstructSettings)
    """How stripes are found in captures."""
    wall_m: float | None = None
    """Roughness of walls, a standard deviation [m]; None: learned from the residuals."""
    closed: bool | None = None
    """Whether the table's full turn is exactly one turn (a gear without slip); None: no assumption."""
    angles: Literal["model", "steps"] = "model"
    """Errors of the table's angles: `model`, its gain and errors once and twice per turn; `steps`, one angle per
    step as well, smooth but for lost steps."""
    angle_sigma: float | None = None
    """Standard deviation of where the table stops about the angle of its record [rad]; None: learned from the walls."""
    features: bool | None = None
    """Whether features of the laser-off images are tracked from step to step; None: where they have texture."""
    marker_dictionary: str | None = None
    """OpenCV's dictionary of printed markers in the room, such as "DICT_4X4_50"; None: any usual one."""
    p_drift: float = 1e-3
    """Chance below which the rig has drifted [1]."""
    least_gain: float = 1.05
    """Least gain of any direction for which a calibration is updated: old over new standard deviation [1]."""
    points: int = 40_000
    """Points on surfaces that are used at most."""
    max_steps: int = 40
    """Steps of one least-squares solve."""


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
