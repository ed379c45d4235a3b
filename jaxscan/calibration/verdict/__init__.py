"""Is a calibration good? Tests of its models, the harm that they find, its uncertainty in lengths, advice, limits."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.calibration.verdict.advice import advise, cure_causes, cures
    from jaxscan.calibration.verdict.describe import JudgedView, describe_quality, judge_views, warn
    from jaxscan.calibration.verdict.harm import Harm, find_harm
    from jaxscan.calibration.verdict.limits import Result, chance, is_held_by_priors, is_named, noise_kind
    from jaxscan.calibration.verdict.propagate import (
        Length,
        depth_sigma,
        focal_share,
        length_sigma,
        measure_good_to,
        measure_lengths,
        predict_lengths,
        refusal,
        stripe_depths,
        stripe_pixels,
        typical_lengths,
    )
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
else:
    load_on_use(__name__)
