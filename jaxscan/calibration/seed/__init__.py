"""First values, before any iteration."""

from jaxscan.calibration.seed.camera import seed_camera
from jaxscan.calibration.seed.closed_form import average_placements, lift_stripes, seed_axis, seed_plane
