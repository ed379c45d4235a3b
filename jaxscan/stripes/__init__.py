"""Frames to stripe centres.

`prepare_engines` learns from the first frames and gives a `StripeEngine` for each laser; `extract_stripes` does
all of it for frames in memory.
"""

from jaxscan.stripes.choosing.by_steps import pick_by_steps
from jaxscan.stripes.engine import ChunkStripes, Continuation, StripeEngine, prepare_engines, stripes_of_frames
from jaxscan.stripes.estimators import ESTIMATORS, Estimator, estimator_of
from jaxscan.stripes.extract import extract_stripes
from jaxscan.stripes.fitting.widths import LEARNED_FRAMES
from jaxscan.stripes.frames.formats import (
    PIXEL_FORMATS,
    Colour,
    FrameFormat,
    LaserColour,
    LaserLine,
    PixelFormat,
    Response,
    decode_table,
    frame_rank,
    laser_plane,
    laser_sites,
)
from jaxscan.stripes.frames.learn_colour import with_colour
from jaxscan.stripes.frames.noise import estimate_noise
from jaxscan.stripes.pairs import judge_pairs
from jaxscan.stripes.search.search import LineGate, whole_lines
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import Choice, FrameStripes, NoiseModel, Stripes, StripeSettings
