"""The gain of an adjustment, whether the rig has drifted, and whether the update can be believed."""

from jaxscan.recalibration.judge.drift import (
    Verdict,
    compared_of,
    find_drift,
    loose,
    moved_parameters,
    with_covariance,
)
from jaxscan.recalibration.judge.flat import flat
from jaxscan.recalibration.judge.gain import gains_of, length_gains, scale_slopes, scales_of, unobserved
from jaxscan.recalibration.judge.refusal import describe_surface, none_is_flat, refuse_result
from jaxscan.recalibration.judge.walls import closure_of, hold_out, panorama_of
