"""Frames to stripes (`extract`), and stripes to a coloured cloud (`reconstruct`)."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.reconstruction.ahead import Progress
    from jaxscan.reconstruction.along import SmoothedSweep, smooth_sweep
    from jaxscan.reconstruction.cloud import (
        MAY_LACK,
        SMOOTHED,
        CloudPoints,
        PointCloud,
        Stations,
        in_scanner_frame,
        join_clouds,
        of_station,
        some_points,
        stack_placed,
    )
    from jaxscan.reconstruction.doubts import journal_doubts, pair_notes, profile_doubts, sweep_doubts
    from jaxscan.reconstruction.extraction import (
        Extraction,
        extract,
    )
    from jaxscan.reconstruction.false_stripes import Decoys
    from jaxscan.reconstruction.kept import extraction_key, kept_arrays, usable_stripes
    from jaxscan.reconstruction.live import IncomingStripes, PlannedSweep, RecordedPair, Show
    from jaxscan.reconstruction.motion import cloud_points, refuse_other_motion
    from jaxscan.reconstruction.plan import Plan, plan_sweep
    from jaxscan.reconstruction.points import grid_normals
    from jaxscan.reconstruction.reconstruct import reconstruct, smooth_stripes
    from jaxscan.reconstruction.seen import FrameWatch, Seen
    from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings, Smooth
    from jaxscan.reconstruction.sweep import FrameChunk, Sweep, SweepSource, colour_exposure
else:
    load_on_use(__name__)
