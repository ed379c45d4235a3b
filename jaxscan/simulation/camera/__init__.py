"""Lens and sensor: from light to DN."""

from jaxscan.simulation.camera.field import Blur, blurred, dimmed, lens_blur, softened, vignette
from jaxscan.simulation.camera.optics import integrate, psf_weights, splat
from jaxscan.simulation.camera.pixels import flawed
from jaxscan.simulation.camera.sensor import (
    COLOURS,
    channels,
    encode_srgb,
    expose,
    laser_response,
    mosaic,
)
