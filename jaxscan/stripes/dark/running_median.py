"""The running median along lines: a background that a stripe does not raise and that keeps its edges."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Int16

from jaxscan.geometry import Array


CODES = 1024
"""Values are whole numbers from 0 to below this."""


def running_median(
    codes: Int16[np.ndarray, "frames lines samples"], half: int
) -> Int16[np.ndarray, "frames lines samples"]:
    """Median of the samples within `half` on both sides; fewer at the ends of a line.

    Args:
        codes: Values from 0 to `CODES` - 1.
        half: Samples on either side.
    """
    out = np.empty_like(codes)
    for frame, result in zip(codes, out, strict=True):
        _lines(np.ascontiguousarray(frame), half, result)
    return out


# Nested functions of numba are not typed.
@numba.njit(nogil=True, cache=True)
@no_type_check
def _lines(codes: Array, half: int, out: Array) -> None:
    lines, samples = codes.shape
    for line in range(lines):
        counts = np.zeros(1024, np.int32)
        inside = min(half + 1, samples)
        for i in range(inside):
            counts[codes[line, i]] += 1
        # `below` counts the values under the median, which is moved step by step.
        median, below = 0, 0
        for i in range(samples):
            if i > 0:
                if i + half < samples:
                    code = codes[line, i + half]
                    counts[code] += 1
                    inside += 1
                    below += code < median
                if i - half - 1 >= 0:
                    code = codes[line, i - half - 1]
                    counts[code] -= 1
                    inside -= 1
                    below -= code < median
            rank = inside // 2
            while below > rank:
                median -= 1
                below -= counts[median]
            while below + counts[median] <= rank:
                below += counts[median]
                median += 1
            out[line, i] = median
