"""Sweeps to flat surfaces of the room and points on them."""

from jaxscan.recalibration.segment.surfaces import Patches, find_patches, observe_surfaces
