"""The loops of the native fit: a block of candidates at a time, the candidates as the lanes of vectors.

They are written for the vectoriser: every loop over lanes goes through one flat array of rows, whose distances
are known at compile time; numbers are of single precision and indices unsigned; and functions of a loop are
polynomials. Constants of other files come as arguments: the compiled code is kept on disk, and only a change of
this file would renew it.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np


LANES = 32
"""Candidates of a block."""
_FAST = {"contract", "arcp", "nsz"}
_part = numba.njit(nogil=True, error_model="numpy", fastmath=_FAST)
_inlined = numba.njit(nogil=True, inline="always")
_sum = numba.njit(nogil=True, fastmath=True)
# Only `fit_lists` is cached on disk: functions that are cached one by one are not inlined into each other.
_whole = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
_f, _u64 = np.float32, np.uint64
_N = _u64(LANES)
_ZERO, _ONE, _HALF, _TWO = _f(0), _f(1), _f(0.5), _f(2)
_LOG2E, _LN2 = _f(1.4426950408889634), _f(0.6931471805599453)
_ROUND, _ROUND_BITS = _f(12582912.0), np.int32(_f(12582912.0).view(np.int32))
_C2, _C3, _C4, _C5, _C6 = (_f(0.6931471805599453**k / np.prod(np.arange(1.0, k + 1))) for k in range(2, 7))
_L3, _L5, _L7 = _f(2 / 3), _f(2 / 5), _f(2 / 7)
_MANTISSA, _EXPONENT, _BIAS, _SHIFT = np.int32(0x7FFFFF), np.int32(0x3F3504F3), np.int32(127), np.int32(23)
_UNUSED = _f(1e30)

# Rows of the flat array: what the candidate is, the state of its fit, and sums over its samples.
_RATIO, _BINS, _START, _EXTENT, _CLIPPED, _TOP, _TALLEST = (_u64(k * LANES) for k in range(7))
_SAMPLES, _STEP, _SHOT, _GRAIN, _PIXEL, _WIDEST, _STEPS, _LOG_STEP = (_u64(k * LANES) for k in range(7, 15))
_MOVING, _U, _AMPLITUDE, _SQUARED, _FLAT, _PER_WIDTH = (_u64(k * LANES) for k in range(15, 21))
_INFORMATION, _ENERGY, _CHI2, _SKEW, _LAST, _ANY = (_u64(k * LANES) for k in range(21, 27))
_M0, _M1, _M2, _M3, _M4, _M6, _F0, _F1, _F2, _F3, _SQUARES, _LIGHT = (_u64(k * LANES) for k in range(27, 39))
_GREY, _WIDTH, _SHIFT_PX = (_u64(k * LANES) for k in range(39, 42))
ROWS = 42
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


@_part
@no_type_check
def _exp(x):
    """Of a number that is not above 80."""
    scaled = x * _LOG2E
    scaled = scaled if scaled > _f(-126) else _f(-126)
    rounded = scaled + _ROUND
    whole = np.int32(_f(rounded).view(np.int32) - _ROUND_BITS)
    f = scaled - (rounded - _ROUND)
    power = _ONE + f * (_LN2 + f * (_C2 + f * (_C3 + f * (_C4 + f * (_C5 + f * _C6)))))
    return power * np.int32((whole + _BIAS) << _SHIFT).view(np.float32)


@_part
@no_type_check
def _log(x):
    """Of a positive number."""
    bits = np.int32(_f(x).view(np.int32) - _EXPONENT)
    power = np.int32(bits >> _SHIFT)
    part = np.int32((bits & _MANTISSA) + _EXPONENT).view(np.float32)
    r = (part - _ONE) / (part + _ONE)
    s = r * r
    return _f(power) * _LN2 + r * (_TWO + s * (_L3 + s * (_L5 + s * _L7)))


@_part
@no_type_check
def _clip(x, low, high):
    x = x if x > low else low
    return x if x < high else high


@_part
@no_type_check
def _rounding(level, table):
    """Of the table's evenly spaced levels of 0 to 255 DN, by interpolation."""
    steps = len(table) - 1
    at = _clip(level, _ZERO, _f(255)) * _f(steps / 255)
    k = min(np.int64(at), steps - 1)
    return table[k] + (at - _f(k)) * (table[k + 1] - table[k])


@_part
@no_type_check
def _levels(w, window, y, variance, place, numbers, count):
    """Levels and variances of one sample of every lane."""
    (on, off, block, s), (read, per_dn, black) = window, numbers
    for i in range(count):
        ratio, dark = w[_RATIO + i], off[block, s, i]
        level = on[block, s, i] - ratio * dark
        light = dark - black
        light = light if light > _ZERO else _ZERO
        light = light * per_dn
        noise = read + ratio * light + ratio * ratio * (read + light)
        x = place * w[_STEP + i] - w[_START + i]
        x = x if x > _ZERO else -x
        used = (on[block, s, i] >= _ZERO) & (x <= w[_EXTENT + i] + _ONE)
        y[s, i] = level
        variance[s, i] = noise / w[_BINS + i] if used else _UNUSED
        counted = level if used else _f(-1e3)
        w[_TOP + i] = counted if counted > w[_TOP + i] else w[_TOP + i]
        w[_SAMPLES + i] += _ONE if used else _ZERO


@_part
@no_type_check
def _grow(w, window, variance, table, least):
    """The part of rounding in the variances of one sample, where it is not that of a linear response."""
    on, off, block, s = window
    for lane in range(LANES):
        i = _u64(lane)
        ratio = w[_RATIO + i]
        if variance[s, i] < _UNUSED:
            more = _rounding(on[block, s, i], table) - least
            more += ratio * ratio * (_rounding(off[block, s, i], table) - least)
            variance[s, i] += more / w[_BINS + i]


@_part
@no_type_check
def _begin(w, numbers, limits, count):
    """Where the fit of every lane starts."""
    pitch, filtered, max_width, speckle, per_dn, smallest = numbers
    few, many = limits
    for i in range(count):
        bins, clipped, extent = w[_BINS + i], w[_CLIPPED + i], w[_EXTENT + i]
        step = w[_STEP + i]
        flat = _HALF * pitch * clipped
        spread = _ONE if clipped > _ZERO else filtered
        squared = (_f(0.25) * extent * extent - flat * flat) / (_TWO * _LN2) - spread
        squared = squared if squared > _f(0.36) else _f(0.36)
        width = _clip(np.sqrt(squared), _f(0.6), max_width)
        taller = _HALF * (flat / width) * (flat / width)
        taller = taller if taller < _f(1.5) else _f(1.5)
        top = w[_TOP + i] if w[_TOP + i] > _ONE else _ONE
        amplitude = top * _exp(taller)
        w[_TALLEST + i] = _f(1e30) if clipped > _ZERO else _TWO * amplitude
        pixel = bins / step
        pixel = pixel * pixel / _f(12)
        widest = _f(1.1) * max_width / step
        widest = widest * widest + pixel
        squared = _clip((width / step) * (width / step) + pixel, smallest, widest)
        w[_PIXEL + i], w[_WIDEST + i], w[_SQUARED + i] = pixel, widest, squared
        w[_SHOT + i], w[_GRAIN + i] = per_dn / bins, speckle / np.sqrt(bins)
        w[_AMPLITUDE + i] = amplitude * width / step / np.sqrt(squared)
        w[_U + i] = w[_START + i] / step
        w[_LOG_STEP + i] = _log(step)
        w[_STEPS + i] = many if clipped > _ZERO else few
        w[_INFORMATION + i] = w[_ENERGY + i] = w[_CHI2 + i] = w[_SKEW + i] = w[_LAST + i] = _ZERO


@_part
@no_type_check
def _prepare_sums(w, count):
    for i in range(count):
        squared, pixel = w[_SQUARED + i], w[_PIXEL + i]
        w[_PER_WIDTH + i] = _ONE / np.sqrt(squared)
        # The fourth cumulant of the pixel, by the Hermite polynomial that belongs to it.
        w[_FLAT + i] = _f(-0.05) * pixel * pixel / (squared * squared)
        w[_M0 + i] = w[_M1 + i] = w[_M2 + i] = w[_M3 + i] = w[_M4 + i] = w[_M6 + i] = _ZERO
        w[_F0 + i] = w[_F1 + i] = w[_F2 + i] = w[_F3 + i] = w[_SQUARES + i] = w[_LIGHT + i] = _ZERO


@_part
@no_type_check
def _add_sample(w, y, variance, s, place, count):
    """Add one sample of every lane to its sums."""
    for i in range(count):
        z = (place - w[_U + i]) * w[_PER_WIDTH + i]
        zz = z * z
        gauss = _exp(-_HALF * zz)
        model = w[_AMPLITUDE + i] * gauss * (_ONE + w[_FLAT + i] * ((zz - _f(6)) * zz + _f(3)))
        bright = model if model > _ZERO else _ZERO
        spread = variance[s, i] + w[_SHOT + i] * bright
        grain = w[_GRAIN + i] * bright
        total = spread + grain * grain
        # One division for both.
        both = _ONE / (spread * total)
        weight = spread * both
        residual = y[s, i] - model
        weighted = weight * gauss
        one = weighted * gauss
        first = weighted * residual
        w[_M0 + i] += one
        w[_M1 + i] += one * z
        w[_M2 + i] += one * zz
        w[_M3 + i] += one * zz * z
        w[_M4 + i] += one * zz * zz
        w[_M6 + i] += one * zz * zz * zz
        w[_F0 + i] += first
        w[_F1 + i] += first * z
        w[_F2 + i] += first * zz
        w[_F3 + i] += first * zz * z
        w[_SQUARES + i] += weight * residual * residual
        w[_LIGHT + i] += total * both * gauss * gauss


@_part
@no_type_check
def _step(w, number, prior, rules, count):
    """Solve the normal equations of every lane and move those that are not at rest."""
    (log_width, width_information), (min_snr, rest, small_step, smallest) = prior, rules
    for i in range(count):
        amplitude, squared = w[_AMPLITUDE + i], w[_SQUARED + i]
        per = _ONE / amplitude
        per_amplitude = width_information * per
        missing = log_width - _HALF * _log(squared) - w[_LOG_STEP + i]
        # Amplitude, width and centre, as in `gaussian_fit`.
        n00, n10, n20 = w[_M0 + i], w[_M2 + i], w[_M1 + i]
        n11, n21, n22 = w[_M4 + i] + per_amplitude * per, w[_M3 + i], w[_M2 + i]
        g0, g1, g2 = w[_F0 + i], w[_F2 + i] + per_amplitude * missing, w[_F1 + i]
        least = _f(1e-6) * n00 + _f(1e-12)
        p0 = n00 if n00 > least else least
        l10, l20 = n10 / p0, n20 / p0
        p1, least = n11 - l10 * l10 * p0, _f(1e-6) * n11 + _f(1e-12)
        p1 = p1 if p1 > least else least
        l21 = (n21 - l20 * l10 * p0) / p1
        p2, least = n22 - l20 * l20 * p0 - l21 * l21 * p1, _f(1e-6) * n22 + _f(1e-12)
        p2 = p2 if p2 > least else least
        f1 = g1 - l10 * g0
        f2 = g2 - l20 * g0 - l21 * f1
        d2 = f2 / p2
        d1 = f1 / p1 - l21 * d2
        d0 = g0 / p0 - l10 * d1 - l20 * d2
        chi2 = w[_SQUARES + i] - (d0 * g0 + d1 * g1 + d2 * g2)
        chi2 = chi2 if chi2 > _ZERO else _ZERO
        width = np.sqrt(squared)
        by_u, by_w, by_a = d2 * per, d1 * per, d0 * per
        size_u, size_w = (by_u if by_u > _ZERO else -by_u), (by_w if by_w > _ZERO else -by_w)
        change = size_u + size_w + (by_a if by_a > _ZERO else -by_a)
        by_a = _clip(by_a, _f(-1.2), _f(1.2))
        small = (by_a if by_a > _ZERO else -by_a) + size_w < small_step
        taller = amplitude * ((_ONE + by_a) if small else _exp(by_a))
        information = taller * taller * p2
        energy = taller * taller * w[_LIGHT + i]
        left = by_u * change
        # The third Hermite polynomial without the part that a shift of the centre explains.
        m2, m4 = w[_M2 + i], w[_M4 + i]
        shifted = m4 - _f(3) * m2
        shifted = shifted * shifted / (m2 if m2 > _f(1e-12) else _f(1e-12))
        cubic = amplitude * (w[_M6 + i] - _f(6) * m4 + _f(9) * m2 - shifted)
        skew = _f(6) * (w[_F3 + i] - _f(3) * w[_F1 + i]) / (cubic if cubic > _f(1e-12) else _f(1e-12))
        limit = _ONE / width
        limit = limit if limit > _ONE else _ONE
        by_width = (_ONE + by_w) * (_ONE + by_w)
        wider = squared * (by_width if small else _ONE / (_ONE - _TWO * _clip(by_w, _f(-0.8), _f(0.3))))
        moves = w[_MOVING + i] > _ZERO
        goes_on = (number + _ONE < w[_STEPS + i]) & (
            # One step alone would leave a wrong chi-squared.
            (number < _ONE) | ((left * left * information > rest * rest) & (energy >= _f(0.64) * min_snr * min_snr))
        )
        w[_MOVING + i] = _ONE if moves & goes_on else _ZERO
        w[_U + i] = w[_U + i] + width * _clip(by_u, -limit, limit) if moves else w[_U + i]
        w[_AMPLITUDE + i] = taller if moves else amplitude
        w[_SQUARED + i] = _clip(wider, smallest, w[_WIDEST + i]) if moves else squared
        w[_INFORMATION + i] = information / squared if moves else w[_INFORMATION + i]
        w[_ENERGY + i] = energy if moves else w[_ENERGY + i]
        w[_CHI2 + i] = chi2 if moves else w[_CHI2 + i]
        w[_SKEW + i] = skew if moves else w[_SKEW + i]
        w[_LAST + i] = width * by_u if moves else w[_LAST + i]


@_sum
@no_type_check
def _moving(w, count):
    total = _ZERO
    for i in range(count):
        total += w[_MOVING + i]
    return total > _ZERO


@_part
@no_type_check
def _prepare_edges(w, min_width, count):
    for i in range(count):
        step, squared, pixel = w[_STEP + i], w[_SQUARED + i], w[_PIXEL + i]
        least = (min_width / step) * (min_width / step)
        width = squared - pixel
        width = np.sqrt(width if width > least else least)
        w[_AMPLITUDE + i] = w[_AMPLITUDE + i] * np.sqrt(squared) / width
        w[_WIDTH + i] = width * step
        seen = width * step
        w[_PER_WIDTH + i] = _ONE / np.sqrt(seen * seen + _f(1 / 12))
        w[_GREY + i] = w[_SHIFT_PX + i] = _ZERO
        w[_M0 + i] = w[_M1 + i] = w[_F0 + i] = w[_F1 + i] = w[_F2 + i] = w[_M2 + i] = w[_M3 + i] = _ZERO


@_part
@no_type_check
def _add_dark(w, window, place, numbers, count):
    """Of one sample of every lane: its part of the grey level, and of the sums of `albedo_shift`."""
    (on, off, block, s), (read, per_dn, black, floor) = window, numbers
    for i in range(count):
        dark, step = off[block, s, i], w[_STEP + i]
        away = place - w[_U + i]
        weight = _ONE - (away if away > _ZERO else -away)
        w[_GREY + i] += (weight if weight > _ZERO else _ZERO) * dark
        light = dark - black
        light = light if light > _ZERO else _ZERO
        variance = (read + light * per_dn) / step
        least = floor * np.sqrt(variance)
        level = dark - black
        per_level = _ONE / (level if level > least else least)
        z = away * step * w[_PER_WIDTH + i]
        gauss = _exp(-_HALF * z * z) if on[block, s, i] >= _ZERO else _ZERO
        source = gauss * per_level
        pull = source * per_level
        pull = pull * pull * variance
        w[_M0 + i] += source
        w[_M1 + i] += source * place
        w[_M2 + i] += gauss
        w[_M3 + i] += gauss * place
        w[_F0 + i] += pull
        w[_F1 + i] += pull * place
        w[_F2 + i] += pull * place * place


@_part
@no_type_check
def _judge_edges(w, certain, count):
    for i in range(count):
        total, plain = w[_M0 + i], w[_M2 + i]
        some = total > _ZERO
        total = total if some else _ONE
        plain = plain if some else _ONE
        mean = w[_M1 + i] / total
        square = w[_F2 + i] - _TWO * mean * w[_F1 + i] + mean * mean * w[_F0 + i]
        sigma = np.sqrt(square if square > _ZERO else _ZERO) / total
        shift = w[_M3 + i] / plain - mean
        size = shift if shift > _ZERO else -shift
        w[_SHIFT_PX + i] = w[_STEP + i] * shift if some & (size > certain * sigma) else _ZERO


@_part
@no_type_check
def _accept(w, found, middle, span, numbers, reach):
    """Judge every lane, and write what is believed."""
    u_of, sigma_of, amplitude_of, width_of, chi2_of, skew_of, snr_of, grey_of, saturated_of, valid_of = found
    first, real = span
    for lane in range(real):
        i, at = _u64(lane), np.int64(first) + lane
        samples, step = w[_SAMPLES + i], w[_STEP + i]
        freedom = max(samples - _f(3), _ONE)
        chi2 = w[_CHI2 + i] / freedom
        expected = _ONE + _f(3) * np.sqrt(_TWO / freedom)
        variance = step * step / w[_INFORMATION + i] if w[_INFORMATION + i] > _ZERO else _ZERO
        sigma = np.sqrt(variance * max(chi2 / expected, _ONE))
        offset, width, energy = w[_U + i] * step, w[_WIDTH + i], w[_ENERGY + i]
        u = middle[lane] + offset
        believed = (
            samples > _f(3)
            and energy >= numbers.least_snr * numbers.least_snr
            and variance > _ZERO
            and sigma <= numbers.max_sigma
            and width >= numbers.min_width
            and width <= numbers.max_width
            and w[_AMPLITUDE + i] <= w[_TALLEST + i]
            and abs(w[_LAST + i]) * step <= _f(0.02) + sigma
            and abs(offset) <= reach * step
            and w[_CHI2 + i] <= numbers.max_chi2 * freedom + numbers.max_misfit * numbers.max_misfit * energy
            and u >= -_HALF
            and u <= numbers.last_sample + _HALF
        )
        valid_of[at] = believed
        if believed:
            u_of[at], amplitude_of[at], width_of[at] = u, w[_AMPLITUDE + i], width
            sigma_of[at] = np.sqrt(sigma * sigma + w[_SHIFT_PX + i] * w[_SHIFT_PX + i])
            chi2_of[at], skew_of[at] = chi2, w[_SKEW + i]
            snr_of[at] = np.sqrt(max(energy, _ZERO))
            grey_of[at], saturated_of[at] = w[_GREY + i], np.uint8(w[_CLIPPED + i])
        else:
            u_of[at] = sigma_of[at] = amplitude_of[at] = width_of[at] = chi2_of[at] = skew_of[at] = _ZERO
            snr_of[at] = grey_of[at] = _ZERO
            saturated_of[at] = 0


@_part
@no_type_check
def _fit_list(candidates, ratio, numbers, table, memory, into):
    """Fit and judge all candidates of a list, into `found` from `behind` on."""
    found, behind = into
    total, frame, start, extent, middle, bins, saturated, on, off = candidates
    w, y, variance = memory
    count, samples = int(total[()]), on.shape[1]
    n = _u64(frame.shape[1])
    read = numbers.read_variance + _f(1 / 12)
    noise = (read, numbers.per_dn, numbers.black)
    starts = (
        numbers.pitch,
        numbers.filter_variance,
        numbers.max_width,
        numbers.speckle,
        numbers.per_dn,
        numbers.smallest,
    )
    prior = (numbers.log_width, numbers.width_information)
    rules = (numbers.least_snr, numbers.rest, numbers.small_step, numbers.smallest)
    middle_sample = _HALF * _f(samples - 1)
    dark = (read, numbers.per_dn, numbers.black, numbers.floor)
    for block in range(-(-count // LANES)):
        u_block = _u64(block)
        real = min(LANES, count - block * LANES)
        for lane in range(LANES):
            i = _u64(lane)
            # Lanes beyond the last candidate repeat it.
            k = min(lane, real - 1)
            w[_RATIO + i], w[_BINS + i] = ratio[frame[block, k]], _f(bins[block, lane] if lane < real else 1)
            w[_START + i], w[_EXTENT + i] = start[block, lane], extent[block, lane]
            w[_CLIPPED + i] = _f(saturated[block, lane])
            w[_STEP + i] = numbers.pitch * w[_BINS + i]
            w[_TOP + i], w[_SAMPLES + i] = _f(-1e3), _ZERO
            w[_MOVING + i] = _ONE if lane < real else _ZERO
        for s in range(_u64(samples)):
            place, window = _f(s) - middle_sample, (on, off, u_block, s)
            _levels(w, window, y, variance, place, noise, n)
            if not numbers.linear:
                _grow(w, window, variance, table, _f(1 / 12))
        _begin(w, starts, (_f(numbers.iterations), _f(numbers.clipped_iterations)), n)
        number = _ZERO
        while _moving(w, n):
            _prepare_sums(w, n)
            for s in range(_u64(samples)):
                _add_sample(w, y, variance, s, _f(s) - middle_sample, n)
            _step(w, number, prior, rules, n)
            number += _ONE
        _prepare_edges(w, numbers.min_width_told, n)
        for s in range(_u64(samples)):
            _add_dark(w, (on, off, u_block, s), _f(s) - middle_sample, dark, n)
        if numbers.guard_edges:
            _judge_edges(w, numbers.certain, n)
        _accept(w, found, middle[block], (behind + block * LANES, real), numbers, _HALF * _f(samples))


@_whole
@no_type_check
def fit_lists(lists, ratio, numbers, table, memory, found):
    """Fit and judge the candidates of both lists of a `Located` in blocks of `LANES`, into flat `FrameStripes`."""
    narrow, wide = lists
    _fit_list(narrow, ratio, numbers, table, memory, (found, np.int64(0)))
    _fit_list(wide, ratio, numbers, table, memory, (found, np.int64(narrow.start.size)))
