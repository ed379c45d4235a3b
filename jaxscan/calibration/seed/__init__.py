"""First values, before any iteration."""

from jaxscan.calibration.seed.camera import seed_camera
from jaxscan.calibration.seed.closed_form import average_placements, seed_axis
from jaxscan.calibration.seed.sheets import seed_sheets
