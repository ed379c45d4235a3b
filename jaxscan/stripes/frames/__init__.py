"""The reading of a frame: pixel format, colour of the laser, noise, lamps that flicker."""

from jaxscan.stripes.frames.flicker import applied_ratio, lamp_ratio
from jaxscan.stripes.frames.formats import (
    PIXEL_FORMATS,
    Colour,
    FrameFormat,
    LaserColour,
    LaserLine,
    PixelFormat,
    Response,
    Sites,
    check_frames,
    decode_table,
    frame_rank,
    known_response,
    laser_plane,
    laser_sites,
)
from jaxscan.stripes.frames.learn_colour import with_colour
from jaxscan.stripes.frames.learn_noise import BlackLevelError, LearnedNoise, check_black, learn_noise, speckle_words
from jaxscan.stripes.frames.learn_response import ExposurePair, LearnedResponse, learn_response
from jaxscan.stripes.frames.levels import (
    DEEP_BITS,
    DEEP_FORMATS,
    clear_level,
    finest_steps,
    join_levels,
    level_exposures,
    split_levels,
    to_8_bits,
)
from jaxscan.stripes.frames.noise import estimate_noise
