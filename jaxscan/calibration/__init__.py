"""Observations to a scanner."""

from jaxscan.calibration.calibrate import calibrate_camera as calibrate_camera
from jaxscan.calibration.calibrate import calibrate_observations as calibrate_observations
from jaxscan.calibration.fit import Fit as Fit
from jaxscan.calibration.result import Calibration as Calibration
from jaxscan.calibration.second_look import choose as choose
from jaxscan.calibration.second_look import solved_rig as solved_rig
from jaxscan.calibration.settings import CalibrationSettings as CalibrationSettings
from jaxscan.calibration.verdict import ModelTest as ModelTest
from jaxscan.calibration.verdict import Quality as Quality
from jaxscan.calibration.verdict import SecondLook as SecondLook
from jaxscan.calibration.verdict import Verdict as Verdict
from jaxscan.calibration.verdict import ViewQuality as ViewQuality
