"""From the samples of a block to levels, variances and the start of its fits."""

from typing import no_type_check

import numpy as np

from jaxscan.stripes.fitting.loops.rows import (
    AMPLITUDE,
    BINS,
    CHI2,
    CLIPPED,
    ENERGY,
    EXTENT,
    GRAIN,
    HALF,
    INFORMATION,
    LANES,
    LAST,
    LN2,
    LOG_STEP,
    ONE,
    PIXEL,
    RATIO,
    SAMPLES,
    SHOT,
    SKEW,
    SQUARED,
    START,
    STEP,
    STEPS,
    TALLEST,
    TOP,
    TWO,
    UNUSED,
    WIDEST,
    ZERO,
    U,
    clip,
    exp,
    f32,
    log,
    part,
    u64,
)


@part
@no_type_check
def _rounding(level, table):
    """Of the table's evenly spaced levels of 0 to 255 DN, by interpolation."""
    steps = len(table) - 1
    at = clip(level, ZERO, f32(255)) * f32(steps / 255)
    k = min(np.int64(at), steps - 1)
    return table[k] + (at - f32(k)) * (table[k + 1] - table[k])


@part
@no_type_check
def levels(w, window, into, place, numbers, count):
    """Levels and variances of one sample of every lane."""
    (on, off, block, s), (y, variance), (read, per_dn, black) = window, into, numbers
    for i in range(count):
        ratio, dark = w[RATIO + i], off[block, s, i]
        level = on[block, s, i] - ratio * dark
        light = dark - black
        light = light if light > ZERO else ZERO
        light = light * per_dn
        noise = read + ratio * light + ratio * ratio * (read + light)
        x = place * w[STEP + i] - w[START + i]
        x = x if x > ZERO else -x
        used = (on[block, s, i] >= ZERO) & (x <= w[EXTENT + i] + ONE)
        y[s, i] = level
        variance[s, i] = noise / w[BINS + i] if used else UNUSED
        counted = level if used else f32(-1e3)
        w[TOP + i] = counted if counted > w[TOP + i] else w[TOP + i]
        w[SAMPLES + i] += ONE if used else ZERO


@part
@no_type_check
def grow(w, window, variance, table, least):
    """The part of rounding in the variances of one sample, where it is not that of a linear response."""
    on, off, block, s = window
    for lane in range(LANES):
        i = u64(lane)
        ratio = w[RATIO + i]
        if variance[s, i] < UNUSED:
            more = _rounding(on[block, s, i], table) - least
            more += ratio * ratio * (_rounding(off[block, s, i], table) - least)
            variance[s, i] += more / w[BINS + i]


@part
@no_type_check
def begin(w, numbers, limits, count):
    """Where the fit of every lane starts."""
    pitch, filtered, max_width, speckle, per_dn, smallest = numbers
    few, many = limits
    for i in range(count):
        bins, clipped, extent = w[BINS + i], w[CLIPPED + i], w[EXTENT + i]
        step = w[STEP + i]
        flat = HALF * pitch * clipped
        spread = ONE if clipped > ZERO else filtered
        squared = (f32(0.25) * extent * extent - flat * flat) / (TWO * LN2) - spread
        squared = squared if squared > f32(0.36) else f32(0.36)
        width = clip(np.sqrt(squared), f32(0.6), max_width)
        taller = HALF * (flat / width) * (flat / width)
        taller = taller if taller < f32(1.5) else f32(1.5)
        top = w[TOP + i] if w[TOP + i] > ONE else ONE
        amplitude = top * exp(taller)
        w[TALLEST + i] = f32(1e30) if clipped > ZERO else TWO * amplitude
        pixel = bins / step
        pixel = pixel * pixel / f32(12)
        widest = f32(1.1) * max_width / step
        widest = widest * widest + pixel
        squared = clip((width / step) * (width / step) + pixel, smallest, widest)
        w[PIXEL + i], w[WIDEST + i], w[SQUARED + i] = pixel, widest, squared
        w[SHOT + i], w[GRAIN + i] = per_dn / bins, speckle / np.sqrt(bins)
        w[AMPLITUDE + i] = amplitude * width / step / np.sqrt(squared)
        w[U + i] = w[START + i] / step
        w[LOG_STEP + i] = log(step)
        w[STEPS + i] = many if clipped > ZERO else few
        w[INFORMATION + i] = w[ENERGY + i] = w[CHI2 + i] = w[SKEW + i] = w[LAST + i] = ZERO
