"""Sweeps to points on planes and spheres."""

from jaxscan.recalibration.segment.flat import flat
from jaxscan.recalibration.segment.spheres import Sphere, find_sphere
from jaxscan.recalibration.segment.surfaces import Patches, find_patches, observe_surfaces
