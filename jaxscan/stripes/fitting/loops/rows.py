"""The numbers, the rows of memory and the functions of the native fit.

A block of candidates is fitted at a time, the candidates as the lanes of vectors. The loops are written for the
vectoriser: every loop over lanes goes through one flat array of rows, whose distances are known at compile time;
numbers are of single precision and indices unsigned; and functions are polynomials. Constants of other folders come
as arguments: the compiled code is kept on disk, and only a change of this folder would renew it.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np


LANES = 32
"""Candidates of a block."""
FAST = {"contract", "arcp", "nsz"}
part = numba.njit(nogil=True, error_model="numpy", fastmath=FAST)
inlined = numba.njit(nogil=True, inline="always")
added = numba.njit(nogil=True, fastmath=True)
# Only what is `whole` is cached on disk: functions that are cached one by one are not inlined into each other.
whole = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=FAST)
f32, u64 = np.float32, np.uint64
ZERO, ONE, HALF, TWO = f32(0), f32(1), f32(0.5), f32(2)
LOG2E, LN2 = f32(1.4426950408889634), f32(0.6931471805599453)
ROUND, ROUND_BITS = f32(12582912.0), np.int32(f32(12582912.0).view(np.int32))
C2, C3, C4, C5, C6 = (f32(0.6931471805599453**k / np.prod(np.arange(1.0, k + 1))) for k in range(2, 7))
L3, L5, L7 = f32(2 / 3), f32(2 / 5), f32(2 / 7)
MANTISSA, EXPONENT, BIAS, SHIFT = np.int32(0x7FFFFF), np.int32(0x3F3504F3), np.int32(127), np.int32(23)
UNUSED = f32(1e30)

# Rows of the flat array: what the candidate is, the state of its fit, and sums over its samples.
RATIO, BINS, START, EXTENT, CLIPPED, TOP, TALLEST = (u64(k * LANES) for k in range(7))
SAMPLES, STEP, SHOT, GRAIN, PIXEL, WIDEST, STEPS, LOG_STEP = (u64(k * LANES) for k in range(7, 15))
MOVING, U, AMPLITUDE, SQUARED, FLAT, PER_WIDTH = (u64(k * LANES) for k in range(15, 21))
INFORMATION, ENERGY, CHI2, SKEW, LAST = (u64(k * LANES) for k in range(21, 26))
M0, M1, M2, M3, M4, M6, F0, F1, F2, F3, SQUARES, LIGHT = (u64(k * LANES) for k in range(26, 38))
GREY, WIDTH, SHIFT_PX = (u64(k * LANES) for k in range(38, 41))
ROWS = 41
"""Rows of that array."""


class FitNumbers(NamedTuple):
    """Numbers of a fit, float32: the noise, the prior, and the limits of `accept`."""

    read_variance: np.float32
    per_dn: np.float32
    black: np.float32
    speckle: np.float32
    log_width: np.float32
    width_information: np.float32
    pitch: np.float32
    filter_variance: np.float32
    max_width: np.float32
    min_width: np.float32
    least_snr: np.float32
    max_sigma: np.float32
    max_chi2: np.float32
    max_misfit: np.float32
    rest: np.float32
    smallest: np.float32
    small_step: np.float32
    min_width_told: np.float32
    certain: np.float32
    floor: np.float32
    last_sample: np.float32
    iterations: int
    clipped_iterations: int
    guard_edges: bool
    linear: bool


class FitMemory(NamedTuple):
    """Of one block: the flat array, and levels and variances of its samples [samples, lanes]."""

    rows: np.ndarray
    y: np.ndarray
    variance: np.ndarray


@part
@no_type_check
def exp(x):
    """Of a number that is not above 80."""
    scaled = x * LOG2E
    scaled = scaled if scaled > f32(-126) else f32(-126)
    rounded = scaled + ROUND
    whole = np.int32(f32(rounded).view(np.int32) - ROUND_BITS)
    f = scaled - (rounded - ROUND)
    power = ONE + f * (LN2 + f * (C2 + f * (C3 + f * (C4 + f * (C5 + f * C6)))))
    return power * np.int32((whole + BIAS) << SHIFT).view(np.float32)


@part
@no_type_check
def log(x):
    """Of a positive number."""
    bits = np.int32(f32(x).view(np.int32) - EXPONENT)
    power = np.int32(bits >> SHIFT)
    part = np.int32((bits & MANTISSA) + EXPONENT).view(np.float32)
    r = (part - ONE) / (part + ONE)
    s = r * r
    return f32(power) * LN2 + r * (TWO + s * (L3 + s * (L5 + s * L7)))


@part
@no_type_check
def clip(x, low, high):
    x = x if x > low else low
    return x if x < high else high
