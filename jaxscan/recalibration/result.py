"""The result of a recalibration, and its verdicts."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration import Calibration
from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import RecalibrationSettings, RoomObservations, Surfaces


class Start(NamedTuple):
    """Where an adjustment begins, T_room_scanner of every station with it; it does not pull the result."""

    scanner: Scanner
    stations: Float[np.ndarray, "stations 4 4"]
    corrections: tuple[Float[np.ndarray, " records"], ...] = ()
    """Known faults of each sweep's angles, which are added to those of the journal [rad]; without any, none."""


@dataclass(frozen=True)
class Adjusted:
    """Scanner, stations, surfaces and angles after one joint least squares of all observations and the prior."""

    scanner: Scanner
    """Its covariance is that after the adjustment; widened where residuals are correlated."""
    prior: Scanner
    """The stored scanner; its covariance is the prior."""
    departure: Float[np.ndarray, " params"]
    """Step from the stored scanner in its minimal coordinates [px, rad, m]."""
    stations: Float[np.ndarray, "stations 4 4"]
    """T_room_scanner of every station; the identity for the first."""
    station_covariance: Float[np.ndarray, "stations 6 6"]
    """Covariance of a step (translation [m], rotation [rad]) in the station's own frame; zero for the first."""
    surfaces: Surfaces
    corrections: tuple[Float[np.ndarray, " records"], ...]
    """Added to the angles of each sweep's journal before the table's own model [rad]: the known faults of the start,
    and the correction found for each image in which features are seen."""
    point_error: Float[np.ndarray, " points"]
    """Signed distance of each point from its surface [m]."""
    point_sigma: Float[np.ndarray, " points"]
    """Standard deviation of that distance by stripe noise and roughness [m]."""
    point_kept: Bool[np.ndarray, " points"]
    track_kept: Bool[np.ndarray, " sightings"]
    wall_m: float
    """Roughness of the walls, given or learned [m]."""
    inflation: float
    """Mean factor of the variances of scanner and stations because points of a wall share errors [1]."""
    observations: RoomObservations
    cost: float
    """Sum of squared whitened residuals, with those of the prior; of boards their excess over the best fit alone."""
    freedom: int
    """Kept residuals less unknowns that no prior holds."""
    converged: bool
    steps: int
    uneven_m: float = 0.0
    """Standard deviation of the walls' shape, which neighbouring points share [m]."""
    stop_sigma: float = 0.0
    """Standard deviation of the table's stops about its angles [rad]; 0 where neither walls nor features show it."""
    misfit: float = 1.0
    """Mean square of the kept points' errors over the variances that were stated before any was learned [1]."""


@dataclass(frozen=True)
class Gain:
    """How much better one direction in the space of the parameters is known than before."""

    name: str
    """ "radial scale", "height scale", or the largest components of the direction."""
    before: float
    """Standard deviation by the stored calibration, in the unit of the name; 1 for a direction."""
    after: float
    unit: str = ""

    @property
    def factor(self) -> float:
        """Old over new standard deviation [1]."""
        return self.before / self.after if self.after > 0 else 1.0


@dataclass(frozen=True)
class LengthGain:
    """Standard deviation that the calibration alone causes in one measured length, before and after."""

    laser: str
    name: str
    depth_m: float
    length_m: float
    before_mm: float
    after_mm: float


@dataclass(frozen=True)
class FoundLength:
    """A known length as it was given, and as the new scanner finds it."""

    metres: float
    sigma_m: float
    found_m: float


@dataclass(frozen=True)
class Moved:
    """A parameter before and after."""

    name: str
    before: float
    after: float
    sigma_before: float
    sigma_after: float
    sigmas: float
    """The change with its sign, in standard deviations that a change would have by chance [1]."""
    unit: str = ""
    """Unit in which it is shown: "degrees", "mm", "px"."""
    scale: float = 1.0
    """Values and standard deviations times this are in that unit."""


@dataclass(frozen=True)
class Drift:
    """Whether the rig is as it was when it was calibrated."""

    chi2: float
    freedom: int
    p: float
    """Chance of so large a departure if nothing moved [1]."""
    drifted: bool
    part: str = ""
    """The part that moved, where one alone explains it: "laser red", "axis", "camera"."""
    size: str = ""
    """How far it moved: "0.050 degrees, 0.03 mm"."""

    @property
    def moves(self) -> list[tuple[tuple[str, ...], str]]:
        """The parts that moved together and how far, for each alternative; the likeliest first."""
        parts, sizes = self.part.split(" or ") if self.part else [], self.size.split(" or ")
        sizes = sizes if len(sizes) == len(parts) else [""] * len(parts)
        return [(tuple(some.split(" and ")), size) for some, size in zip(parts, sizes, strict=True)]


@dataclass(frozen=True)
class HoldOut:
    """Flatness of planes that were not used, with the old and the new calibration; for each half of them."""

    before_mm: tuple[float, ...]
    after_mm: tuple[float, ...]
    better: bool


@dataclass(frozen=True)
class TableFindings:
    """Steps that the table lost."""

    jumps: tuple[tuple[int, int, float], ...] = ()
    """Sweep, record and angle [rad] from which on the table stands elsewhere: lost steps."""
    corrections: tuple[Float[np.ndarray, " _"], ...] = ()
    """Added to the angles of each sweep [rad]; they correct the jumps."""
    sentences: tuple[str, ...] = ()


@dataclass(frozen=True)
class Closure:
    """The gap that is left after a full turn."""

    before_mm: float | None
    """Gap at 2.5 m with the stored calibration; None where nothing is seen twice."""
    after_mm: float | None
    """None where no overlap shows it."""
    sigma_mm: float
    """Standard deviation of the gap with the new calibration."""
    source: str
    """ "overlap", "features" or "model"."""


@dataclass(frozen=True)
class PanoramaOfWalls:
    """Distances of the points of one sweep from their planes on the grid [profile, line], before and after [m]."""

    sweep: str
    before: Float[np.ndarray, "profiles lines"]
    after: Float[np.ndarray, "profiles lines"]
    seen: Bool[np.ndarray, "profiles lines"]
    """Points that lie on a plane."""
    angle: Float[np.ndarray, " profiles"] | None = None
    """The table's angle of each profile [rad]; None: evenly spread over one turn."""


@dataclass(frozen=True)
class Recalibration:
    """A refined scanner, and everything by which it can be judged."""

    scanner: Scanner
    """The new scanner with its covariance; the stored one where the update was refused."""
    updated: bool
    refused: str
    """Why nothing was updated; empty where it was."""
    adjusted: Adjusted
    drift: Drift
    gains: tuple[Gain, ...]
    """Radial scale and height scale first, then the directions, best known last."""
    unobserved: tuple[str, ...]
    """Directions that these captures say nothing of; a sentence each."""
    moved: tuple[Moved, ...]
    hold_out: HoldOut | None
    table: TableFindings
    closure: Closure | None
    panoramas: tuple[PanoramaOfWalls, ...]
    notes: tuple[str, ...] = ()
    lengths: tuple[LengthGain, ...] = ()
    """Typical lengths; those of the adjusted scanner also where the update is refused."""
    known: tuple[FoundLength, ...] = ()
    calibration: Calibration | None = None
    """The new calibration, to be saved; None where nothing was updated."""
    settings: RecalibrationSettings = field(default_factory=RecalibrationSettings)
