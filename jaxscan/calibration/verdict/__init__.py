"""Is a calibration good? Tests of its models, the harm that they find, its uncertainty in lengths, advice, limits."""

from jaxscan.calibration.verdict.advice import advise, cure_causes, cures, refusal, warn
from jaxscan.calibration.verdict.propagate import (
    Length,
    depth_sigma,
    focal_share,
    length_sigma,
    measure_good_to,
    measure_lengths,
    predict_lengths,
    stripe_depths,
    stripe_pixels,
    typical_lengths,
)
from jaxscan.calibration.verdict.quality import (
    BoardMap,
    DepthSigma,
    Direction,
    GoodTo,
    JudgedView,
    LaserLengths,
    Lengths,
    LengthSigma,
    Missed,
    ModelTest,
    PriorShare,
    Quality,
    SecondLook,
    Verdict,
    ViewQuality,
    chance,
    is_held_by_priors,
    is_named,
    judge_views,
    noise_kind,
)
from jaxscan.calibration.verdict.structure import Harm, find_harm
