"""Sweeps to flat surfaces of the room and points on them."""

from jaxscan.recalibration.segment.surfaces import label_planes, observe_surfaces
