"""Frames of more than 8 bits: kept as levels, and what that gains."""

import numpy as np
import pytest
from scipy.special import erf

from jaxscan.stripes import (
    DEEP_BITS,
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    StripeSettings,
    level_exposures,
    prepare_engines,
    split_levels,
    to_8_bits,
)


ROWS, COLUMNS, FRAMES, BITS = 128, 256, 8, 12
ELECTRONS, READ = 10_000.0, 4.0
"""Of a pixel at the top of the range, and of the read noise: those of a common sensor of 12 bits."""


@pytest.mark.parametrize("bits", DEEP_BITS)
def test_levels_hold_a_frame(bits):
    frame = np.random.default_rng(0).integers(0, 1 << bits, (40, 50), np.uint16)
    frame[0, :2] = 0, (1 << bits) - 1
    levels = split_levels(frame, bits)
    assert [exposure for _, exposure in levels] == list(level_exposures(bits)) and len(levels) == min(3, bits // 2 - 3)
    for image, exposure in levels:
        assert image.dtype == np.uint8 and image[0, 1] == 255
        inside = image < 255
        # Rounded to the nearest step.
        assert np.abs(image[inside] / exposure - frame[inside]).max() <= 0.5 / exposure
    np.testing.assert_array_equal(levels[0][0], to_8_bits(frame, bits))


def photographed(peak):
    """True centres, and laser-on and laser-off frames of 12 bits, of stripes so bright [DN of 12 bits]."""
    rng = np.random.default_rng(1)
    full, row = (1 << BITS) - 1, np.arange(ROWS)
    u = 128 + 20 * np.sin(row / 60) + rng.uniform(-0.5, 0.5, (FRAMES, 1))
    x, width = np.arange(COLUMNS), 1.6
    room = 0.02 * full * (1 + 0.3 * np.sin(x / 50)) * np.ones((FRAMES, ROWS, 1))
    edges = erf((np.append(x, COLUMNS) - 0.5 - u[..., None]) / width / np.sqrt(2))
    lit = room + peak * width * np.sqrt(np.pi / 2) * np.diff(edges, axis=-1)

    def camera(light):
        electrons = rng.poisson(light * ELECTRONS / full) + rng.normal(0, READ, light.shape)
        return np.clip(np.rint(electrons * full / ELECTRONS + 0.01 * full), 0, full).astype(np.uint16)

    return u, camera(lit), camera(room)


def found(on, off, exposures, level):
    setup = ExtractionSetup((COLUMNS, ROWS), FrameFormat(), LaserLine(), StripeSettings(), exposures, level)
    (engine,) = prepare_engines(on, off, [setup])
    stripes = engine.learn(on, off).extract(on, off).stripes
    return np.asarray(stripes.u), np.asarray(stripes.sigma), np.asarray(stripes.valid), np.asarray(stripes.amplitude)


def levels(frames):
    return np.stack([np.stack([image for image, _ in split_levels(one, BITS)]) for one in frames])


# Measured: 0.83 of the error of 8 bits for faint stripes, the same for bright ones.
@pytest.mark.more
@pytest.mark.parametrize(("peak", "most"), [(80.0, 0.9), (320.0, 0.95), (3000.0, 1.01)])
def test_a_faint_stripe_gains_and_a_bright_one_loses_nothing(peak, most):
    u, on, off = photographed(peak)
    centre, sigma, valid, amplitude = found(levels(on), levels(off), level_exposures(BITS), 0)
    plain = found(to_8_bits(on, BITS), to_8_bits(off, BITS), (1.0,), None)
    both = valid & plain[2]
    assert valid.mean() > 0.99 and both.mean() > 0.97
    rms = lambda values: float(np.sqrt(np.mean((values - u)[both] ** 2)))
    assert rms(centre) < most * rms(plain[0])
    # The sigmas are true: the spread of 1000 ratios is known to 3 %, beside the linearisation of faint ones.
    assert np.std(((centre - u) / np.where(valid, sigma, 1))[valid]) == pytest.approx(1.0, abs=0.12)
    # In steps of 8 bits, whichever level was taken.
    assert np.median(amplitude[valid]) == pytest.approx(peak / 16, rel=0.05)


@pytest.mark.more
def test_two_records_are_those_of_each_alone():
    """Of two, the second level of the last one lies in memory as a whole array does."""
    _, on, off = photographed(320.0)
    on, off = levels(on), levels(off)
    setup = ExtractionSetup((COLUMNS, ROWS), FrameFormat(), LaserLine(), StripeSettings(), level_exposures(BITS), 0)
    (engine,) = prepare_engines(on, off, [setup])
    both = engine.extract(on[2:4], off[2:4], 4).stripes
    for k in (2, 3):
        alone = engine.extract(on[k : k + 1], off[k : k + 1], 4).stripes
        np.testing.assert_array_equal(np.asarray(both.u)[k - 2], np.asarray(alone.u)[0])
