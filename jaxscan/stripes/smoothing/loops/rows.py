"""The rows of memory, the numbers and the small functions of the smoothing's loops.

The centres of a profile stand one after the other, with a margin of empty ones at both ends. Blocks of them are copied
into a flat array of rows, whose distances are known at compile time, and sums over their neighbours go into another
one: so the vectoriser takes the centres as the lanes of vectors. What does not belong to a window has no weight in it.
Numbers of other folders come as arguments: the compiled code is kept on disk, and only a change of this folder would
renew it.
"""

from typing import no_type_check

import numba
import numpy as np


# Sums may be fused and quotients become products: faster by a third.
FAST = {"contract", "arcp", "nsz"}
part = numba.njit(nogil=True, error_model="numpy", fastmath=FAST)
inlined = numba.njit(nogil=True, inline="always")
# Only what is `whole` is cached on disk: functions that are cached one by one are not inlined into each other.
whole = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=FAST)
u64 = np.uint64
BLOCK, MARGIN = 64, 24
"""Centres of a block, and those around it that windows reach: more than twice the largest half window."""
AROUND = BLOCK + 2 * MARGIN

# Rows of the array `r`: place, centre and weight of a block with its margins, and the edges behind each.
X, Y, W, E = (u64(k * AROUND + MARGIN) for k in range(4))
# Rows of the array `w`: sums and results of the lanes of a block.
S0, S1, S2, S3, S4, T0, T1, T2, Q, USED = (u64(k * BLOCK) for k in range(10))
A0, A1, A2, B0, B1, LINES, GOES_ON, RESULT = (u64(k * BLOCK) for k in range(10, 18))
LEFT, RIGHT, FIRST, LAST, BEFORE, AFTER = (u64(k * BLOCK) for k in range(18, 24))
VALUE, VARIANCE, SPREAD, LOW, HIGH, NOW, THEN = (u64(k * BLOCK) for k in range(24, 31))
SUMS = 31
"""Rows of that array."""


@inlined
@no_type_check
def line(s0, s1, s2, t0, t1):
    """Of a weighted straight line at 0: value, slope, their variances and covariance; no variance without a line."""
    det = s0 * s2 - s1 * s1
    known = det > 1e-9 * s0 * s2
    part = 1.0 / (det if known else 1.0)
    return (s2 * t0 - s1 * t1) * part, (s0 * t1 - s1 * t0) * part, s2 * part if known else -1.0


@inlined
@no_type_check
def parabola(s, t):
    """Of a weighted parabola at 0: value, slope, curvature, and the value's variance; none without a parabola."""
    (s0, s1, s2, s3, s4), (t0, t1, t2) = s, t
    c00, c01, c02 = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
    det = s0 * c00 + s1 * c01 + s2 * c02
    known = det > 1e-9 * s0 * s2 * s4
    part, c12 = 1.0 / (det if known else 1.0), s1 * s2 - s0 * s3
    value = (c00 * t0 + c01 * t1 + c02 * t2) * part
    slope = (c01 * t0 + (s0 * s4 - s2 * s2) * t1 + c12 * t2) * part
    return value, slope, (c02 * t0 + c12 * t1 + (s0 * s2 - s1 * s1) * t2) * part, c00 * part if known else -1.0


@part
@no_type_check
def fill(r, rows, start, count):
    """Copy a block with its margins from the arrays of a profile, which have a margin of their own."""
    x, y, weight, edge = rows
    for i in range(count):
        k = start + i
        r[i] = x[k]
        r[i + u64(AROUND)] = y[k]
        r[i + u64(2 * AROUND)] = weight[k]
        r[i + u64(3 * AROUND)] = edge[k]


@part
@no_type_check
def clear(w, first, count):
    for i in range(count):
        w[first + i] = 0.0
