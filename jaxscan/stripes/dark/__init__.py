"""Frames as they would be without the laser, where a capture has none: predicted from the laser-on frames."""

from jaxscan.stripes.dark.channels import Channels, read_channels
from jaxscan.stripes.dark.native import warped
from jaxscan.stripes.dark.predict import box_mean, predict_off
