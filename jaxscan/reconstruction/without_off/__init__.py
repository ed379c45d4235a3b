"""Sweeps without laser-off frames: these are predicted from the laser-on frames."""

from jaxscan.reconstruction.without_off.source import PredictedPairs, with_off
