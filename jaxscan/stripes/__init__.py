"""Frames to stripe centres.

`prepare_engines` learns from the first frames and gives a `StripeEngine` for each laser; `extract_stripes` does
all of it for frames in memory.
"""

from jaxscan.stripes.choosing.by_steps import pick_by_steps as pick_by_steps
from jaxscan.stripes.engine import ChunkStripes as ChunkStripes
from jaxscan.stripes.engine import Continuation as Continuation
from jaxscan.stripes.engine import StripeEngine as StripeEngine
from jaxscan.stripes.engine import prepare_engines as prepare_engines
from jaxscan.stripes.engine import stripes_of_frames as stripes_of_frames
from jaxscan.stripes.estimators import ESTIMATORS as ESTIMATORS
from jaxscan.stripes.estimators import Estimator as Estimator
from jaxscan.stripes.estimators import estimator_of as estimator_of
from jaxscan.stripes.extract import extract_stripes as extract_stripes
from jaxscan.stripes.fitting.widths import LEARNED_FRAMES as LEARNED_FRAMES
from jaxscan.stripes.frames.formats import PIXEL_FORMATS as PIXEL_FORMATS
from jaxscan.stripes.frames.formats import Colour as Colour
from jaxscan.stripes.frames.formats import FrameFormat as FrameFormat
from jaxscan.stripes.frames.formats import LaserColour as LaserColour
from jaxscan.stripes.frames.formats import LaserLine as LaserLine
from jaxscan.stripes.frames.formats import PixelFormat as PixelFormat
from jaxscan.stripes.frames.formats import Response as Response
from jaxscan.stripes.frames.formats import decode_table as decode_table
from jaxscan.stripes.frames.formats import frame_rank as frame_rank
from jaxscan.stripes.frames.formats import laser_plane as laser_plane
from jaxscan.stripes.frames.formats import laser_sites as laser_sites
from jaxscan.stripes.frames.learn_colour import with_colour as with_colour
from jaxscan.stripes.frames.noise import estimate_noise as estimate_noise
from jaxscan.stripes.pairs import judge_pairs as judge_pairs
from jaxscan.stripes.search.search import LineGate as LineGate
from jaxscan.stripes.search.search import whole_lines as whole_lines
from jaxscan.stripes.setup import ExtractionSetup as ExtractionSetup
from jaxscan.stripes.stripes import Choice as Choice
from jaxscan.stripes.stripes import FrameStripes as FrameStripes
from jaxscan.stripes.stripes import NoiseModel as NoiseModel
from jaxscan.stripes.stripes import Stripes as Stripes
from jaxscan.stripes.stripes import StripeSettings as StripeSettings
