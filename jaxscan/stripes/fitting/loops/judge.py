"""The edges under the stripes of a block, and which of its fits are believed."""

from typing import no_type_check

import numpy as np

from jaxscan.stripes.fitting.loops.rows import (
    AMPLITUDE,
    CHI2,
    CLIPPED,
    ENERGY,
    F0,
    F1,
    F2,
    GREY,
    HALF,
    INFORMATION,
    LAST,
    M0,
    M1,
    M2,
    M3,
    ONE,
    PER_WIDTH,
    PIXEL,
    SAMPLES,
    SHIFT_PX,
    SKEW,
    SQUARED,
    STEP,
    TALLEST,
    TWO,
    WIDTH,
    ZERO,
    U,
    exp,
    f32,
    part,
    u64,
)


@part
@no_type_check
def prepare_edges(w, min_width, count):
    for i in range(count):
        step, squared, pixel = w[STEP + i], w[SQUARED + i], w[PIXEL + i]
        least = (min_width / step) * (min_width / step)
        width = squared - pixel
        width = np.sqrt(width if width > least else least)
        w[AMPLITUDE + i] = w[AMPLITUDE + i] * np.sqrt(squared) / width
        w[WIDTH + i] = width * step
        seen = width * step
        w[PER_WIDTH + i] = ONE / np.sqrt(seen * seen + f32(1 / 12))
        w[GREY + i] = w[SHIFT_PX + i] = ZERO
        w[M0 + i] = w[M1 + i] = w[F0 + i] = w[F1 + i] = w[F2 + i] = w[M2 + i] = w[M3 + i] = ZERO


@part
@no_type_check
def add_dark(w, window, place, numbers, count):
    """Of one sample of every lane: its part of the grey level, and of the sums of `albedo_shift`."""
    (on, off, block, s), (read, per_dn, black, floor) = window, numbers
    for i in range(count):
        dark, step = off[block, s, i], w[STEP + i]
        away = place - w[U + i]
        weight = ONE - (away if away > ZERO else -away)
        w[GREY + i] += (weight if weight > ZERO else ZERO) * dark
        light = dark - black
        light = light if light > ZERO else ZERO
        variance = (read + light * per_dn) / step
        least = floor * np.sqrt(variance)
        level = dark - black
        per_level = ONE / (level if level > least else least)
        z = away * step * w[PER_WIDTH + i]
        gauss = exp(-HALF * z * z) if on[block, s, i] >= ZERO else ZERO
        source = gauss * per_level
        pull = source * per_level
        pull = pull * pull * variance
        w[M0 + i] += source
        w[M1 + i] += source * place
        w[M2 + i] += gauss
        w[M3 + i] += gauss * place
        w[F0 + i] += pull
        w[F1 + i] += pull * place
        w[F2 + i] += pull * place * place


@part
@no_type_check
def judge_edges(w, certain, count):
    for i in range(count):
        total, plain = w[M0 + i], w[M2 + i]
        some = total > ZERO
        total = total if some else ONE
        plain = plain if some else ONE
        mean = w[M1 + i] / total
        square = w[F2 + i] - TWO * mean * w[F1 + i] + mean * mean * w[F0 + i]
        sigma = np.sqrt(square if square > ZERO else ZERO) / total
        shift = w[M3 + i] / plain - mean
        size = shift if shift > ZERO else -shift
        w[SHIFT_PX + i] = w[STEP + i] * shift if some & (size > certain * sigma) else ZERO


@part
@no_type_check
def accept(w, found, middle, span, numbers, reach):
    """Judge every lane, and write what is believed."""
    u_of, sigma_of, amplitude_of, width_of, chi2_of, skew_of, snr_of, grey_of, saturated_of, valid_of = found
    first, real = span
    for lane in range(real):
        i, at = u64(lane), np.int64(first) + lane
        samples, step = w[SAMPLES + i], w[STEP + i]
        freedom = max(samples - f32(3), ONE)
        chi2 = w[CHI2 + i] / freedom
        expected = ONE + f32(3) * np.sqrt(TWO / freedom)
        variance = step * step / w[INFORMATION + i] if w[INFORMATION + i] > ZERO else ZERO
        sigma = np.sqrt(variance * max(chi2 / expected, ONE))
        offset, width, energy = w[U + i] * step, w[WIDTH + i], w[ENERGY + i]
        u = middle[lane] + offset
        believed = (
            samples > f32(3)
            and energy >= numbers.least_snr * numbers.least_snr
            and variance > ZERO
            and sigma <= numbers.max_sigma
            and width >= numbers.min_width
            and width <= numbers.max_width
            and w[AMPLITUDE + i] <= w[TALLEST + i]
            and abs(w[LAST + i]) * step <= f32(0.02) + sigma
            and abs(offset) <= reach * step
            and w[CHI2 + i] <= numbers.max_chi2 * freedom + numbers.max_misfit * numbers.max_misfit * energy
            and u >= -HALF
            and u <= numbers.last_sample + HALF
        )
        valid_of[at] = believed
        if believed:
            u_of[at], amplitude_of[at], width_of[at] = u, w[AMPLITUDE + i], width
            sigma_of[at] = np.sqrt(sigma * sigma + w[SHIFT_PX + i] * w[SHIFT_PX + i])
            chi2_of[at], skew_of[at] = chi2, w[SKEW + i]
            snr_of[at] = np.sqrt(max(energy, ZERO))
            grey_of[at], saturated_of[at] = w[GREY + i], np.uint8(w[CLIPPED + i])
        else:
            u_of[at] = sigma_of[at] = amplitude_of[at] = width_of[at] = chi2_of[at] = skew_of[at] = ZERO
            snr_of[at] = grey_of[at] = ZERO
            saturated_of[at] = 0
