"""The loops of the native fit; they load numba."""

from jaxscan.stripes.fitting.loops.rows import LANES, ROWS, FitMemory, FitNumbers
from jaxscan.stripes.fitting.loops.whole import fit_lists
