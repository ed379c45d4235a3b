"""Is a calibration good? Tests of its models, its uncertainty in lengths, advice, and the limits of it all."""

from jaxscan.calibration.verdict.advice import advise, cures
from jaxscan.calibration.verdict.describe import describe_quality, warn
from jaxscan.calibration.verdict.judge import judge
from jaxscan.calibration.verdict.lengths import (
    Length,
    depth_sigma,
    length_changes,
    length_sigma,
    measure_lengths,
    predict_lengths,
    stripe_depths,
    stripe_pixels,
    typical_lengths,
)
from jaxscan.calibration.verdict.limits import Result, is_held_by_priors, noise_kind
from jaxscan.calibration.verdict.quality import (
    BoardMap,
    DepthSigma,
    Direction,
    LaserLengths,
    Lengths,
    LengthSigma,
    ModelTest,
    PriorShare,
    Quality,
    SecondLook,
    Verdict,
    ViewQuality,
    reach_verdict,
)
from jaxscan.calibration.verdict.views import JudgedView, judge_views
