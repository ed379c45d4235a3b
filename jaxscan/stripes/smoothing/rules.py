"""Limits of the smoothing, as its native loops take them."""

from typing import NamedTuple

import numpy as np


class Rules(NamedTuple):
    """Limits of edges, stray centres, and good fits."""

    sizes: np.ndarray
    """Half sizes of windows, and lines on either side of a possible edge, ascending."""
    gap: float
    """Largest distance of neighbouring lines on one surface."""
    straight: float
    """How well it is known that surfaces are straight: information of a prior of the curvature, in that of two rows;
    corners of a few standard deviations a line are still seen, and spheres are not cut into pieces."""
    edge: float
    """Chi-squared by which two straight lines are better than a parabola, from which there is an edge."""
    doubt: float
    """The same from which there may be one."""
    even: float
    """The same at which that is as likely as not."""
    stray: float
    """Standard deviations by which a stray centre lies off the line through its neighbours."""
    agree: float
    """Chi-squared of two degrees of freedom up to which those neighbours lie on a line."""
    misfit: float
    """Standard deviations by which the chi-squared of a fit may exceed its degrees of freedom."""
    apart: float
    """Standard deviations by which the value of a window may differ from that of the smaller one."""
    first_misfit: float
    """As `misfit` of the smallest window, whose few degrees of freedom scatter further."""
    first_apart: float
    """As `apart` from the row itself, which is not better than the smallest window unless a jump is plain."""
