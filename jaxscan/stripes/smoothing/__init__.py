"""Centres along the stripe: neighbouring lines where the surface is continuous, none across an edge."""

from jaxscan.stripes.smoothing.scale import ProfileRows, Scatter, ScatterLaw, row_scatter, scatter_law
from jaxscan.stripes.smoothing.smooth import Smoothed, smooth_profiles
