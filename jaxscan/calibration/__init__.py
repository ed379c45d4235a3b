"""Observations to a scanner."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.calibration.advice import refusal, warn_of_missing_lines
    from jaxscan.calibration.calibrate import (
        Estimate,
        calibrate_camera,
        calibrate_observations,
        choose,
        estimate,
        judge,
        solved_rig,
    )
    from jaxscan.calibration.other_lens import settle_lens
    from jaxscan.calibration.propagate import (
        Length,
        depth_sigma,
        length_sigma,
        measure_good_to,
        measure_lengths,
        predict_lengths,
        stripe_depths,
        stripe_pixels,
        typical_lengths,
    )
    from jaxscan.calibration.result import (
        BoardMap,
        Calibration,
        DepthSigma,
        Direction,
        Fit,
        GoodTo,
        GoodToPart,
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
        is_held_by_priors,
        is_named,
        judge_views,
        largest_departure,
        noise_kind,
    )
    from jaxscan.calibration.rigs import NOTHING_KNOWN, KnownParts, Part, Rig, planned_rig
    from jaxscan.calibration.settings import PRIORS, USUALLY_FREE, Block, CalibrationSettings, RigKind
else:
    load_on_use(__name__)
