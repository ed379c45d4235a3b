"""Frames to stripe centres."""

from jaxscan.stripes.chunk import stripes_of_frames as stripes_of_frames
from jaxscan.stripes.extract import extract_stripes as extract_stripes
from jaxscan.stripes.frames.formats import PIXEL_FORMATS as PIXEL_FORMATS
from jaxscan.stripes.frames.formats import LaserLine as LaserLine
from jaxscan.stripes.frames.formats import PixelFormat as PixelFormat
from jaxscan.stripes.frames.formats import Response as Response
from jaxscan.stripes.frames.formats import frame_rank as frame_rank
from jaxscan.stripes.frames.noise import estimate_noise as estimate_noise
from jaxscan.stripes.stripes import FrameStripes as FrameStripes
from jaxscan.stripes.stripes import NoiseModel as NoiseModel
from jaxscan.stripes.stripes import Stripes as Stripes
from jaxscan.stripes.stripes import StripeSettings as StripeSettings
