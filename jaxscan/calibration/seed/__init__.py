"""First values, before any iteration."""

from jaxscan.calibration.seed.camera import seed_camera
from jaxscan.calibration.seed.closed_form import seed_poses
from jaxscan.calibration.seed.motion import average_placements, seed_motion
from jaxscan.calibration.seed.sheets import seed_sheets
