"""Frames to stripe centres.

`prepare_engines` learns from the first frames and gives a `StripeEngine` for each laser; `extract_stripes` does
all of it for frames in memory.
"""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.stripes.choose import chosen_of, pick_by_steps
    from jaxscan.stripes.engine import ChunkStripes, StripeEngine, prepare_engines, stripes_of_frames
    from jaxscan.stripes.estimators import ESTIMATORS, Estimator, estimator_of
    from jaxscan.stripes.extract import extract_stripes
    from jaxscan.stripes.frames import (
        DEEP_BITS,
        DEEP_FORMATS,
        PIXEL_FORMATS,
        BlackLevelError,
        Colour,
        ExposurePair,
        FrameFormat,
        LaserColour,
        LaserLine,
        LearnedNoise,
        LearnedResponse,
        PixelFormat,
        Response,
        Sites,
        check_frames,
        clear_level,
        decode_table,
        estimate_noise,
        finest_steps,
        frame_rank,
        join_levels,
        known_response,
        laser_plane,
        laser_sites,
        learn_noise,
        learn_response,
        level_exposures,
        speckle_words,
        split_levels,
        to_8_bits,
        with_colour,
    )
    from jaxscan.stripes.mosaic import mosaic_wave
    from jaxscan.stripes.pairs import judge_pairs
    from jaxscan.stripes.predict import Channels, box_mean, predict_off, read_channels, warped
    from jaxscan.stripes.scatter import ProfileRows, ScatterLaw, scatter_law
    from jaxscan.stripes.search import LEARNED_FRAMES, ExtractionSetup, LineGate, whole_lines
    from jaxscan.stripes.smooth import Smoothed, smooth_profiles
    from jaxscan.stripes.stripes import KEPT_FIELDS, Choice, FrameStripes, NoiseModel, Stripes, StripeSettings
else:
    load_on_use(__name__)
