"""Ordinary sweeps to a better scanner: the room as calibration target."""

from jaxscan.recalibration.adjusted import Adjusted, Start
from jaxscan.recalibration.given import Given, KnownSphere, MeasuredLength, Place
from jaxscan.recalibration.observed import (
    KnownLength,
    RoomObservations,
    SurfacePoints,
    Surfaces,
    SweepStripes,
    Tracks,
)
from jaxscan.recalibration.prior import require_prior
from jaxscan.recalibration.recalibrate import recalibrate
from jaxscan.recalibration.renew import renew_calibration
from jaxscan.recalibration.result import (
    Closure,
    Drift,
    FoundLength,
    Gain,
    HoldOut,
    LengthGain,
    Moved,
    PanoramaOfWalls,
    Recalibration,
    TableFindings,
)
from jaxscan.recalibration.settings import RecalibrationSettings
from jaxscan.recalibration.table import points_of_records
from jaxscan.recalibration.tracks import FeatureEyes, observe_features
from jaxscan.recalibration.used import earlier_captures, refuse_used
