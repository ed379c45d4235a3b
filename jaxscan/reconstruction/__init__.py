"""Stripes to a coloured cloud."""

from jaxscan.reconstruction.cloud import SMOOTHED, CloudPoints, PointCloud, Stations, some_points
from jaxscan.reconstruction.doubts import (
    FrameWatch,
    Seen,
    cloud_points,
    journal_doubts,
    profile_doubts,
    refuse_other_motion,
    sweep_doubts,
)
from jaxscan.reconstruction.extraction import (
    Progress,
    StripePart,
    can_be_split,
    stripes_of_part,
    stripes_of_parts,
    stripes_of_plan,
)
from jaxscan.reconstruction.incoming import IncomingStripes, PlannedSweep, RecordedPair, Show
from jaxscan.reconstruction.joining import in_scanner_frame, join_clouds, of_station, stack_placed
from jaxscan.reconstruction.kept import extraction_key, kept_arrays, usable_stripes
from jaxscan.reconstruction.pair_notes import pair_notes
from jaxscan.reconstruction.plan import Plan, make_plan
from jaxscan.reconstruction.reconstruct import (
    cloud_of_plan,
    extract_sweep,
    reconstruct,
    smooth_stripes,
)
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings, Smooth
from jaxscan.reconstruction.sweep import FrameChunk, Sweep, SweepSource
