"""A stripe that is lost in the noise of each line is found in several together; where it ends or is hidden, none is."""

import numpy as np
import pytest

from jaxscan.stripes import NoiseModel, extract_stripes


ROWS, COLUMNS, WIDTH = 2048, 96, 1.3
KNOWN = NoiseModel(read_dn=1.0, electrons_per_dn=40.0)
COHERENT = NoiseModel(read_dn=1.0, electrons_per_dn=40.0, speckle=0.45)
# Signal-to-noise ratio of a row whose peak is 1 DN: root of the sum of squares over the noise of a difference's pixel.
SNR_PER_DN = np.sqrt(WIDTH * np.sqrt(np.pi)) / np.sqrt(2 * (1.0 + 10 / 40 + 1 / 12))


def seen(sensor, profile, snr, u, noise=KNOWN):
    """Rows of a stripe with such signal-to-noise ratios on rows [rows], by the public call."""
    draw = sensor(seed=3)
    on = profile(u, WIDTH, 1.0, COLUMNS) * (snr / SNR_PER_DN)[:, None] + 10.0
    pair = [draw.expose(level)[None] for level in (on, np.full_like(on, 10.0))]
    found = extract_stripes(*pair, noise=noise)
    return (np.asarray(field)[0] for field in (found.u, found.sigma, found.valid))


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_a_stripe_is_found_that_no_row_shows_by_itself(slope, sensor, profile):
    rows = np.arange(ROWS)
    phase = (slope * rows + 8.0) % 16.0
    centre, sigma, valid = seen(sensor, profile, np.full(ROWS, 3.2), COLUMNS / 2 + phase - 8.0)
    # Not where the course begins anew.
    smooth = (phase > 1.0) & (phase < 15.0)
    # The sum has 5 times as much signal at 2.2 times the noise, so 7.2 beside the 4.8 that are asked for. By its own
    # noise one row of ten is under 1.0, or errs by more than the 1.5 px.
    assert valid[smooth].mean() > 0.85
    error = (centre - (COLUMNS / 2 + phase - 8.0))[smooth & valid]
    # One row of 50 lies on noise that was found by itself.
    near = np.abs(error) < 2.0
    assert np.mean(~near) < 0.02
    # Errors are cut off at the reach; sigmas are taken at the amplitude that noise has raised or lowered.
    assert 0.85 < np.sqrt(np.mean(sigma[smooth & valid][near] ** 2) / np.mean(error[near] ** 2)) < 1.5


def test_a_row_that_faded_in_speckle_is_found(sensor, profile):
    rows = np.arange(ROWS)
    faded = rows % 10 >= 7
    u = np.full(ROWS, COLUMNS / 2 + 0.3)
    centre, _, valid = seen(sensor, profile, np.where(faded, 2.8, 10.0), u, COHERENT)
    assert valid[~faded].all()
    # By its noise, one row of eight is too faint even for speckle, or errs by more than the 1.5 px.
    assert valid[faded].mean() > 0.8
    # The search by itself believes some that noise lifted elsewhere.
    assert np.mean(np.abs(centre - u)[faded & valid] > 1.6) < 0.02


def test_a_dark_row_between_bright_ones_is_dark(sensor, profile):
    dark = np.arange(ROWS) % 20 >= 14
    _, _, valid = seen(sensor, profile, np.where(dark, 0.0, 37.0), np.full(ROWS, COLUMNS / 2 + 0.3))
    # The search by itself finds one row of a thousand in noise.
    assert valid[dark].mean() < 0.005


def test_a_stripe_does_not_grow_beyond_its_end_or_over_a_step(sensor, profile):
    rows = np.arange(ROWS)
    u = np.where(rows % 40 < 20, 30.3, 60.3)
    dark = rows % 20 >= 14
    _, _, valid = seen(sensor, profile, np.where(dark, 0.0, 37.0), u, COHERENT)
    # Two rows at either end of six are in sums with bright ones: they need 2.0 to 4.1 of their own, which noise has at
    # one of about three places on a row of 15 and of 10 000.
    assert valid[dark].mean() < 0.05


def test_noise_alone_has_no_stripe(sensor, profile):
    _, _, valid = seen(sensor, profile, np.zeros(ROWS), np.full(ROWS, COLUMNS / 2))
    # About 40 places on a row at 4.8 standard deviations, five rows at a time.
    assert valid.mean() < 0.002
