"""Observations to a scanner."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.calibration.calibrate import Estimate, calibrate_camera, calibrate_observations, estimate, judge
    from jaxscan.calibration.departure import largest_departure
    from jaxscan.calibration.fit import Fit
    from jaxscan.calibration.known import NOTHING_KNOWN, KnownParts, Part
    from jaxscan.calibration.other_lens import settle_lens
    from jaxscan.calibration.result import Calibration
    from jaxscan.calibration.rigs import Rig, planned_rig
    from jaxscan.calibration.second_look import choose, solved_rig
    from jaxscan.calibration.settings import CalibrationSettings
    from jaxscan.calibration.verdict import Missed, ModelTest, Quality, SecondLook, Verdict, ViewQuality
else:
    load_on_use(__name__)
