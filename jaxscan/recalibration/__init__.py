"""Ordinary sweeps to a better scanner: the room as calibration target."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.recalibration.observed import (
        Given,
        KnownLength,
        MeasuredLength,
        Place,
        RecalibrationSettings,
        RoomObservations,
        SurfacePoints,
        Surfaces,
        SweepStripes,
        Tracks,
    )
    from jaxscan.recalibration.recalibrate import recalibrate, register
    from jaxscan.recalibration.renew import earlier_captures, refuse_used, renew_calibration, require_prior
    from jaxscan.recalibration.result import (
        Adjusted,
        Closure,
        Drift,
        FoundLength,
        Gain,
        HoldOut,
        LengthGain,
        Moved,
        PanoramaOfWalls,
        Recalibration,
        Start,
        TableFindings,
    )
    from jaxscan.recalibration.tracks import FeatureEyes, observe_features
    from jaxscan.recalibration.triangulate import points_of_records
else:
    load_on_use(__name__)
