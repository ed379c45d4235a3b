"""Sweeps to points on planes and spheres."""

from jaxscan.recalibration.segment.observe import observe_surfaces
from jaxscan.recalibration.segment.patches import Patches, find_patches
