"""The result of one adjustment of the scanner to a room."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration import Fit
from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import RoomObservations, Surfaces


class Start(NamedTuple):
    """Where an adjustment begins; it does not pull the result."""

    scanner: Scanner
    """The stored one, or that of an adjustment before."""
    stations: Float[np.ndarray, "stations 4 4"]
    """T_room_scanner of every station; the identity for the first."""
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
    """Of a step (translation [m], rotation [rad]) in the station's own frame; zero for the first."""
    surfaces: Surfaces
    corrections: tuple[Float[np.ndarray, " records"], ...]
    """Added to the angles of each sweep's journal before the table's own model [rad]: the known faults of the start,
    and with `angles="steps"` the correction found for each record."""
    correction_sigma: tuple[Float[np.ndarray, " records"], ...]
    point_error: Float[np.ndarray, " points"]
    """Signed distance of each point from its surface [m]."""
    point_sigma: Float[np.ndarray, " points"]
    """Standard deviation of that distance by stripe noise and roughness [m]."""
    point_kept: Bool[np.ndarray, " points"]
    track_error: Float[np.ndarray, "sightings 2"]
    """Projected minus seen [px]."""
    track_kept: Bool[np.ndarray, " sightings"]
    wall_m: float
    """Roughness of the walls, given or learned [m]."""
    inflation: float
    """Mean factor of the variances of scanner and stations because points of a wall share errors [1]."""
    observations: RoomObservations
    """As they were given."""
    cost: float
    """Sum of squared whitened residuals, with those of the prior; of boards their excess over the best fit alone."""
    freedom: int
    """Kept residuals less unknowns that no prior holds."""
    converged: bool
    steps: int
    boards: Fit | None = None
    """Residuals on the boards, where there were any."""
    uneven_m: float = 0.0
    """Standard deviation of the walls' shape, which neighbouring points share [m]."""
    stop_sigma: float = 0.0
    """Standard deviation of the table's stops about its angles [rad]; 0 where walls do not show it."""
    misfit: float = 1.0
    """Mean square of the kept points' errors over the variances that were stated before any was learned [1]."""
