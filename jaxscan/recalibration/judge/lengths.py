"""The gain in lengths that people measure."""

from jaxscan.calibration.verdict import Lengths
from jaxscan.recalibration.result import LengthGain


def length_gains(before: Lengths, after: Lengths) -> tuple[LengthGain, ...]:
    """The lengths that are in reach of both calibrations, with their standard deviations."""
    new = {(laser.name, one.name, one.depth_m): one for laser in after.lasers for one in laser.lengths}
    return tuple(
        LengthGain(laser.name, one.name, one.depth_m, one.length_m, one.sigma_mm, found.sigma_mm)
        for laser in before.lasers
        for one in laser.lengths
        if (found := new.get((laser.name, one.name, one.depth_m))) is not None
    )
