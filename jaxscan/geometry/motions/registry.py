"""The blocks of all motions."""

from jaxscan.geometry.motions.linear_stage import LinearStage
from jaxscan.geometry.motions.turntable import Turntable


MOTION_BLOCKS = tuple(dict.fromkeys(Turntable.blocks + LinearStage.blocks))
"""Blocks that any motion has."""
