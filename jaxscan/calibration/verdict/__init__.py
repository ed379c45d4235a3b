"""Is a calibration good? Tests of its models, the harm that they find, its uncertainty in lengths, advice, limits."""

from jaxscan.calibration.verdict.advice import advise, cure_causes, cures
from jaxscan.calibration.verdict.describe import describe_quality, warn
from jaxscan.calibration.verdict.good_to import focal_share, measure_good_to, refusal
from jaxscan.calibration.verdict.harm import Harm, find_harm
from jaxscan.calibration.verdict.lengths import (
    Length,
    depth_sigma,
    length_sigma,
    measure_lengths,
    predict_lengths,
    stripe_depths,
    stripe_pixels,
    typical_lengths,
)
from jaxscan.calibration.verdict.limits import Result, chance, is_held_by_priors, is_named, noise_kind
from jaxscan.calibration.verdict.quality import (
    BoardMap,
    DepthSigma,
    Direction,
    GoodTo,
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
)
from jaxscan.calibration.verdict.views import JudgedView, judge_views
