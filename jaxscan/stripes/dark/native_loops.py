"""The loops of the prediction: running medians, and frames as another step would show them."""

from typing import no_type_check

import numba
import numpy as np


CODES = 1024
"""Values of which medians are taken are whole numbers from 0 to below this."""
_loop = numba.njit(nogil=True, cache=True)


@_loop
@no_type_check
def median_of_lines(codes, half, out):
    """Median of the samples within `half` on both sides, of every line of one frame."""
    lines, samples = codes.shape
    for line in range(lines):
        counts = np.zeros(CODES, np.int32)
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


@_loop
@no_type_check
def warp(planes, where, out, pitch):
    """Bilinear in the planes, at places that are bilinear between the nodes; beyond the plane its border."""
    count, lines, samples = planes.shape
    for line in range(lines):
        i = line // pitch
        down = np.float32(line % pitch) / np.float32(pitch)
        for sample in range(samples):
            j = sample // pitch
            right = np.float32(sample % pitch) / np.float32(pitch)
            a, b = (1 - down) * (1 - right), (1 - down) * right
            c, d = down * (1 - right), down * right
            y = a * where[i, j, 0] + b * where[i, j + 1, 0] + c * where[i + 1, j, 0] + d * where[i + 1, j + 1, 0]
            x = a * where[i, j, 1] + b * where[i, j + 1, 1] + c * where[i + 1, j, 1] + d * where[i + 1, j + 1, 1]
            y = min(max(y, np.float32(0)), np.float32(lines - 1))
            x = min(max(x, np.float32(0)), np.float32(samples - 1))
            top, left = int(y), int(x)
            bottom, after = min(top + 1, lines - 1), min(left + 1, samples - 1)
            fy, fx = y - top, x - left
            for p in range(count):
                upper = (1 - fx) * planes[p, top, left] + fx * planes[p, top, after]
                lower = (1 - fx) * planes[p, bottom, left] + fx * planes[p, bottom, after]
                out[p, line, sample] = (1 - fy) * upper + fy * lower
