"""Observations to a scanner."""

from jaxscan.calibration.calibrate import calibrate_camera as calibrate_camera
from jaxscan.calibration.calibrate import calibrate_observations as calibrate_observations
from jaxscan.calibration.observations import BoardViews as BoardViews
from jaxscan.calibration.observations import Observations as Observations
from jaxscan.calibration.observations import StripeViews as StripeViews
from jaxscan.calibration.result import Calibration as Calibration
from jaxscan.calibration.settings import CalibrationSettings as CalibrationSettings
from jaxscan.calibration.stripes_on_board import BoardStripe as BoardStripe
from jaxscan.calibration.stripes_on_board import select_board_stripes as select_board_stripes
from jaxscan.calibration.stripes_on_board import stack_stripes as stack_stripes
