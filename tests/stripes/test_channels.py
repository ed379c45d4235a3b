"""Channels of a colour camera as a bracket."""

import numpy as np
import pytest

from jaxscan.stripes import ExtractionSetup, FrameFormat, LaserLine, StripeSettings, extract_stripes, prepare_engines


ROWS, COLUMNS = 400, 128
WIDTH_PX = 1.5
WIDE_SETUP = ExtractionSetup((COLUMNS, ROWS), FrameFormat("rgb8"), LaserLine(), StripeSettings())


def pair(sensor, peak, crosstalk=0.1, seed=0):
    """Pairs of a red stripe."""
    camera = sensor(seed=seed)
    u = camera.rng.uniform(60.0, 68.0, ROWS)
    x = np.arange(COLUMNS)[None, :] - u[:, None]
    stripe = peak * np.exp(-0.5 * (x / WIDTH_PX) ** 2)

    light = np.stack([stripe, crosstalk * stripe, 0.5 * crosstalk * stripe], -1) + 20.0
    return camera.expose(light)[None], camera.expose(np.full(light.shape, 20.0))[None], u


def engine_of(on, off):
    (engine,) = prepare_engines(on, off, [WIDE_SETUP])
    return engine


def test_other_channels_are_looked_at_only_where_the_own_is_clipped(sensor):
    on, off, _ = pair(sensor, 150.0)
    assert engine_of(on, off).channels == ()
    on, off, _ = pair(sensor, 1500.0)
    engine = engine_of(on, off)
    assert [one.setup.line.colour for one in engine.channels] == ["green", "blue"]
    # The red flanks tell how much of the laser the others see.
    np.testing.assert_allclose(engine.responses, [0.1, 0.05], rtol=0.05)


@pytest.mark.more
def test_where_red_is_clipped_green_gives_the_centre(sensor):
    on, off, u = pair(sensor, 1500.0)
    stripes = extract_stripes(on, off, pixel_format="rgb8")
    red = extract_stripes(np.ascontiguousarray(on[..., 0]), np.ascontiguousarray(off[..., 0]))
    valid = np.asarray(stripes.valid)[0]
    error = np.asarray(stripes.u)[0] - u
    assert valid.mean() > 0.99
    rms = np.sqrt(np.mean(error[valid] ** 2))
    of_red = np.sqrt(np.mean((np.asarray(red.u)[0] - u)[np.asarray(red.valid)[0]] ** 2))
    assert rms < 1.05 * of_red
    # Honest: within a quarter, of 400 lines.
    assert 0.75 < np.sqrt(np.mean((error / np.asarray(stripes.sigma)[0])[valid] ** 2)) < 1.25
    # Amplitudes are those that red would have.
    assert 0.8 < np.median(np.asarray(stripes.amplitude)[0][valid]) / 1500.0 < 1.2
