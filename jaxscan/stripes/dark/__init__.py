"""Frames as they would be without the laser, where a capture has none: predicted from the laser-on frames."""

from jaxscan.stripes.dark.predict import predict_off
