"""Finds the laser's line in two frames of a rig, as `jaxscan reconstruct` finds it in those of a capture."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from jaxscan import api
from jaxscan.stripes import FrameFormat, LaserLine


if TYPE_CHECKING:
    from scanrig.config import RigConfig


def line_finder(rig: "RigConfig", line: LaserLine) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A function of a laser-on and a laser-off frame that gives the stripe's centres [n, 2] [px]."""
    return partial(_find_line, FrameFormat(rig.camera.pixel_format, rig.camera.response), line)


def _find_line(frames: FrameFormat, line: LaserLine, on: np.ndarray, off: np.ndarray) -> np.ndarray:
    stripes = api.extract_stripes(on, off, pixel_format=frames, line=line)
    valid = np.asarray(stripes.valid)[0]
    points = np.column_stack([np.asarray(stripes.u)[0][valid], np.flatnonzero(valid)]).astype(float)
    return points if line.stripe_axis == "rows" else points[:, ::-1]
