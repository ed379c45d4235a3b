"""The gain of an adjustment, whether the rig has drifted, and whether the update is accepted."""

from jaxscan.recalibration.judge.drift import (
    Verdict,
    compared_of,
    find_drift,
    gains_of,
    length_gains,
    loose,
    moved_parameters,
    scale_slopes,
    scales_of,
    unobserved,
    with_covariance,
)
from jaxscan.recalibration.judge.refusal import describe_surface, none_is_flat, refuse_result
from jaxscan.recalibration.judge.walls import closure_of, flat, hold_out, panorama_of
