"""The centre of each candidate, fitted and judged."""

from jaxscan.stripes.fitting.albedo import DarkWindow, moments
from jaxscan.stripes.fitting.fit_blocks import fit_candidates
