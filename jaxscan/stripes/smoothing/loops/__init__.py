"""The loops of the smoothing; they load numba."""

from jaxscan.stripes.smoothing.loops.whole import memory_of, smooth_block
