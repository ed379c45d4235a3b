"""First values, before any iteration."""

from jaxscan.calibration.seed.camera import seed_camera as seed_camera
from jaxscan.calibration.seed.closed_form import average_placements as average_placements
from jaxscan.calibration.seed.closed_form import lift_stripes as lift_stripes
from jaxscan.calibration.seed.closed_form import seed_axis as seed_axis
from jaxscan.calibration.seed.closed_form import seed_plane as seed_plane
