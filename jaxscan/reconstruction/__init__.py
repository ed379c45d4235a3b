"""Stripes to a coloured cloud."""

from jaxscan.reconstruction.cloud import CloudPoints as CloudPoints
from jaxscan.reconstruction.cloud import PointCloud as PointCloud
from jaxscan.reconstruction.incoming import IncomingStripes as IncomingStripes
from jaxscan.reconstruction.incoming import PlannedSweep as PlannedSweep
from jaxscan.reconstruction.incoming import RecordedPair as RecordedPair
from jaxscan.reconstruction.kept import extraction_key as extraction_key
from jaxscan.reconstruction.kept import kept_arrays as kept_arrays
from jaxscan.reconstruction.kept import usable_stripes as usable_stripes
from jaxscan.reconstruction.pair_notes import pair_notes as pair_notes
from jaxscan.reconstruction.plan import Plan as Plan
from jaxscan.reconstruction.plan import make_plan as make_plan
from jaxscan.reconstruction.reconstruct import Progress as Progress
from jaxscan.reconstruction.reconstruct import cloud_of_plan as cloud_of_plan
from jaxscan.reconstruction.reconstruct import extract_sweep as extract_sweep
from jaxscan.reconstruction.reconstruct import reconstruct as reconstruct
from jaxscan.reconstruction.reconstruct import stripes_of_plan as stripes_of_plan
from jaxscan.reconstruction.settings import DEFAULTS as DEFAULTS
from jaxscan.reconstruction.settings import ReconstructSettings as ReconstructSettings
from jaxscan.reconstruction.sweep import FrameChunk as FrameChunk
from jaxscan.reconstruction.sweep import Sweep as Sweep
from jaxscan.reconstruction.sweep import SweepSource as SweepSource
