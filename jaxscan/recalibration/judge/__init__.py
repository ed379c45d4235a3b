"""The gain of an adjustment, whether the rig has drifted, and whether the update can be believed."""

from jaxscan.recalibration.judge.closure import closure_of
from jaxscan.recalibration.judge.drift import moved_parameters
from jaxscan.recalibration.judge.gain import gains_of, length_gains, scale_slopes, scales_of, unobserved
from jaxscan.recalibration.judge.hold_out import hold_out
from jaxscan.recalibration.judge.panorama import panorama_of
from jaxscan.recalibration.judge.refusal import describe_surface, none_is_flat, refuse_result
from jaxscan.recalibration.judge.verdict import (
    Verdict,
    compared_of,
    find_drift,
    loose,
    with_covariance,
)
