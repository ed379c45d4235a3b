"""One step of the fits of a block."""

from typing import no_type_check

import numpy as np

from jaxscan.stripes.fitting.loops.rows import (
    AMPLITUDE,
    CHI2,
    ENERGY,
    F0,
    F1,
    F2,
    F3,
    FLAT,
    GRAIN,
    HALF,
    INFORMATION,
    LAST,
    LIGHT,
    LOG_STEP,
    M0,
    M1,
    M2,
    M3,
    M4,
    M6,
    MOVING,
    ONE,
    PER_WIDTH,
    PIXEL,
    SHOT,
    SKEW,
    SQUARED,
    SQUARES,
    STEPS,
    TWO,
    WIDEST,
    ZERO,
    U,
    added,
    clip,
    exp,
    f32,
    log,
    part,
)


@part
@no_type_check
def prepare_sums(w, count):
    for i in range(count):
        squared, pixel = w[SQUARED + i], w[PIXEL + i]
        w[PER_WIDTH + i] = ONE / np.sqrt(squared)
        # The fourth cumulant of the pixel, by the Hermite polynomial that belongs to it.
        w[FLAT + i] = f32(-0.05) * pixel * pixel / (squared * squared)
        w[M0 + i] = w[M1 + i] = w[M2 + i] = w[M3 + i] = w[M4 + i] = w[M6 + i] = ZERO
        w[F0 + i] = w[F1 + i] = w[F2 + i] = w[F3 + i] = w[SQUARES + i] = w[LIGHT + i] = ZERO


@part
@no_type_check
def add_sample(w, y, variance, s, place, count):
    """Add one sample of every lane to its sums."""
    for i in range(count):
        z = (place - w[U + i]) * w[PER_WIDTH + i]
        zz = z * z
        gauss = exp(-HALF * zz)
        model = w[AMPLITUDE + i] * gauss * (ONE + w[FLAT + i] * ((zz - f32(6)) * zz + f32(3)))
        bright = model if model > ZERO else ZERO
        spread = variance[s, i] + w[SHOT + i] * bright
        grain = w[GRAIN + i] * bright
        total = spread + grain * grain
        # One division for both.
        both = ONE / (spread * total)
        weight = spread * both
        residual = y[s, i] - model
        weighted = weight * gauss
        one = weighted * gauss
        first = weighted * residual
        w[M0 + i] += one
        w[M1 + i] += one * z
        w[M2 + i] += one * zz
        w[M3 + i] += one * zz * z
        w[M4 + i] += one * zz * zz
        w[M6 + i] += one * zz * zz * zz
        w[F0 + i] += first
        w[F1 + i] += first * z
        w[F2 + i] += first * zz
        w[F3 + i] += first * zz * z
        w[SQUARES + i] += weight * residual * residual
        w[LIGHT + i] += total * both * gauss * gauss


@part
@no_type_check
def step(w, number, prior, rules, count):
    """Solve the normal equations of every lane and move those that are not at rest."""
    (log_width, width_information), (min_snr, rest, small_step, smallest) = prior, rules
    for i in range(count):
        amplitude, squared = w[AMPLITUDE + i], w[SQUARED + i]
        per = ONE / amplitude
        per_amplitude = width_information * per
        missing = log_width - HALF * log(squared) - w[LOG_STEP + i]
        # Amplitude, width and centre, as in `gaussian_fit`.
        n00, n10, n20 = w[M0 + i], w[M2 + i], w[M1 + i]
        n11, n21, n22 = w[M4 + i] + per_amplitude * per, w[M3 + i], w[M2 + i]
        g0, g1, g2 = w[F0 + i], w[F2 + i] + per_amplitude * missing, w[F1 + i]
        least = f32(1e-6) * n00 + f32(1e-12)
        p0 = n00 if n00 > least else least
        l10, l20 = n10 / p0, n20 / p0
        p1, least = n11 - l10 * l10 * p0, f32(1e-6) * n11 + f32(1e-12)
        p1 = p1 if p1 > least else least
        l21 = (n21 - l20 * l10 * p0) / p1
        p2, least = n22 - l20 * l20 * p0 - l21 * l21 * p1, f32(1e-6) * n22 + f32(1e-12)
        p2 = p2 if p2 > least else least
        f1 = g1 - l10 * g0
        f2 = g2 - l20 * g0 - l21 * f1
        d2 = f2 / p2
        d1 = f1 / p1 - l21 * d2
        d0 = g0 / p0 - l10 * d1 - l20 * d2
        chi2 = w[SQUARES + i] - (d0 * g0 + d1 * g1 + d2 * g2)
        chi2 = chi2 if chi2 > ZERO else ZERO
        width = np.sqrt(squared)
        by_u, by_w, by_a = d2 * per, d1 * per, d0 * per
        size_u, size_w = (by_u if by_u > ZERO else -by_u), (by_w if by_w > ZERO else -by_w)
        change = size_u + size_w + (by_a if by_a > ZERO else -by_a)
        by_a = clip(by_a, f32(-1.2), f32(1.2))
        small = (by_a if by_a > ZERO else -by_a) + size_w < small_step
        taller = amplitude * ((ONE + by_a) if small else exp(by_a))
        information = taller * taller * p2
        energy = taller * taller * w[LIGHT + i]
        left = by_u * change
        # The third Hermite polynomial without the part that a shift of the centre explains.
        m2, m4 = w[M2 + i], w[M4 + i]
        shifted = m4 - f32(3) * m2
        shifted = shifted * shifted / (m2 if m2 > f32(1e-12) else f32(1e-12))
        cubic = amplitude * (w[M6 + i] - f32(6) * m4 + f32(9) * m2 - shifted)
        skew = f32(6) * (w[F3 + i] - f32(3) * w[F1 + i]) / (cubic if cubic > f32(1e-12) else f32(1e-12))
        limit = ONE / width
        limit = limit if limit > ONE else ONE
        by_width = (ONE + by_w) * (ONE + by_w)
        wider = squared * (by_width if small else ONE / (ONE - TWO * clip(by_w, f32(-0.8), f32(0.3))))
        moves = w[MOVING + i] > ZERO
        goes_on = (number + ONE < w[STEPS + i]) & (
            # One step alone would leave a wrong chi-squared.
            (number < ONE) | ((left * left * information > rest * rest) & (energy >= f32(0.64) * min_snr * min_snr))
        )
        w[MOVING + i] = ONE if moves & goes_on else ZERO
        w[U + i] = w[U + i] + width * clip(by_u, -limit, limit) if moves else w[U + i]
        w[AMPLITUDE + i] = taller if moves else amplitude
        w[SQUARED + i] = clip(wider, smallest, w[WIDEST + i]) if moves else squared
        w[INFORMATION + i] = information / squared if moves else w[INFORMATION + i]
        w[ENERGY + i] = energy if moves else w[ENERGY + i]
        w[CHI2 + i] = chi2 if moves else w[CHI2 + i]
        w[SKEW + i] = skew if moves else w[SKEW + i]
        w[LAST + i] = width * by_u if moves else w[LAST + i]


@added
@no_type_check
def moving(w, count):
    total = ZERO
    for i in range(count):
        total += w[MOVING + i]
    return total > ZERO
