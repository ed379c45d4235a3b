"""Smoothed sweeps of surfaces with honest sigmas of the rows: the noise that is left, and its stated sigma."""

import numpy as np
import pytest

from jaxscan.reconstruction.along import smooth_sweep
from jaxscan.stripes import Sites, Stripes


LINES, PROFILES = 240, 120
X = np.arange(LINES)
SLOPE = np.linspace(-0.6, 0.6, PROFILES)[:, None]
PHASE = np.linspace(0, 1, PROFILES, endpoint=False)[:, None]


def noise_of(correlation, seed=1):
    """Noise of variance 1 whose next neighbours are alike."""
    drawn = np.random.default_rng(seed).normal(size=(PROFILES, LINES + 1))
    weight = np.sin(0.5 * np.arcsin(2 * correlation)), np.cos(0.5 * np.arcsin(2 * correlation))
    return weight[0] * drawn[:, :-1] + weight[1] * drawn[:, 1:]


def stripes_of(u, sigma, valid=None, laser=None, amplitude=50.0):
    u = np.asarray(u, np.float32)
    valid = np.ones(u.shape, bool) if valid is None else np.broadcast_to(valid, u.shape)
    full = {name: np.zeros(u.shape, np.float32) for name in ("width", "chi2", "skew")}
    return Stripes(
        u=u,
        sigma=np.broadcast_to(np.asarray(sigma, np.float32), u.shape).copy(),
        amplitude=np.broadcast_to(np.asarray(amplitude, np.float32), u.shape),
        saturated=np.zeros(u.shape, np.uint8),
        valid=valid,
        record=np.arange(len(u), dtype=np.int32),
        laser=np.zeros(len(u), np.int32) if laser is None else laser,
        **full,
    )


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def sphere(radius):
    across = (X - 120 + 8 * (PHASE - 0.5)) / radius
    return 300 + 0.5 * radius * np.sqrt(np.maximum(1 - across**2, 0)), np.abs(across) < 0.95


def wave(height, period):
    return 300 + SLOPE * X + height * np.sin(2 * np.pi * (X / period + PHASE)), np.ones((PROFILES, LINES), bool)


SURFACES = {
    "plane": (wave(0, 40), 0.1, 0.0),
    "plane, rows a little alike": (wave(0, 40), 0.1, 0.15),
    "plane, rows alike": (wave(0, 40), 0.1, 0.3),
    "sphere of 60 rows": (sphere(60), 0.02, 0.0),
    "sphere of 60 rows, bright": (sphere(60), 0.01, 0.0),
    "sphere of 100 rows": (sphere(100), 0.02, 0.0),
    "sphere of 150 rows, bright": (sphere(150), 0.01, 0.0),
    "wave of 2 px in 40 rows": (wave(2, 40), 0.02, 0.0),
    "wave of 1 px in 25 rows": (wave(1, 25), 0.02, 0.0),
    "wave, rows alike": (wave(2, 40), 0.02, 0.3),
    "strips of 12 rows": ((300 + 3 * ((X // 12) % 2) + SLOPE * X, np.ones((PROFILES, LINES), bool)), 0.1, 0.0),
}


@pytest.mark.more
@pytest.mark.parametrize("name", SURFACES)
def test_what_is_left_is_stated(name):
    (truth, valid), sigma, correlation = SURFACES[name]
    u = truth + sigma * noise_of(correlation)
    found = smooth_sweep(stripes_of(u, sigma, valid))
    error, row, stated = (field[np.broadcast_to(valid, u.shape)] for field in (found.u - truth, u - truth, found.sigma))
    assert rms(error) < (0.6 if name.startswith("plane") else 1.0) * rms(row)
    assert 0.9 < rms(stated) / rms(error) < 1.1
    assert np.mean(np.abs(error) > 5 * stated) <= 1e-3
    # The rows were honest before: nothing but the likeness of neighbours is added.
    own = found.sigma_row[np.broadcast_to(valid, u.shape)]
    assert np.median(own) / sigma == pytest.approx(np.sqrt(1 + 2 * correlation), rel=0.06)


@pytest.mark.more
@pytest.mark.parametrize("height", [5, 8, 25, 500])
def test_beside_a_step(height):
    truth = 300 + SLOPE * X + 0.1 * height * (X >= 120)
    found = smooth_sweep(stripes_of(truth + 0.1 * noise_of(0.0), 0.1))
    near = np.abs(X - 119.5) <= 10
    error, stated = (found.u - truth)[:, near], found.sigma[:, near]
    assert rms(error) < 0.07 and 0.9 < rms(stated) / rms(error) < 1.1
    assert np.mean(np.abs(error) > 5 * stated) <= 1e-3


@pytest.mark.more
def test_an_average_of_rows_that_are_alike():
    """Rows of sigma_row that are taken for independent promise of an average as much as it is worth."""
    u = 0.1 * noise_of(0.3)
    found = smooth_sweep(stripes_of(300 + SLOPE * X + u, 0.1))
    inside = slice(20, -20)
    count = u[:, inside].shape[1]
    promised = np.sqrt((found.sigma_row[:, inside] ** 2).mean() / count)
    shared = np.sqrt((found.sigma[:, inside] ** 2 * found.shared_lines[:, inside]).mean() / count)
    # 120 averages: 6.5 %.
    error = rms((found.u - 300 - SLOPE * X)[:, inside].mean(1))
    assert promised / error == pytest.approx(1.0, abs=0.15) and shared / error == pytest.approx(1.0, abs=0.15)


def test_every_laser_has_a_scatter_of_its_own():
    """Two lasers in turn, of which the second scatters twice as much as its fits promise."""
    laser = (np.arange(PROFILES) % 2).astype(np.int32)
    truth = 300 + SLOPE * X
    u = truth + 0.1 * (1 + laser[:, None]) * noise_of(0.0)
    found = smooth_sweep(stripes_of(u, 0.1, laser=laser))
    for number, scale in ((0, 1.0), (1, 2.0)):
        assert np.median(found.sigma_row[laser == number]) / 0.1 == pytest.approx(scale, rel=0.05)


def test_an_error_that_rows_share_stays():
    """An edge of the paint along the stripe: rows err by 0.2 px together and say so, though they hardly scatter."""
    truth, painted = 300 + SLOPE * X, np.zeros((PROFILES, LINES), bool)
    painted[::8, 60:120] = True
    u = truth + 0.05 * noise_of(0.0) + 0.2 * painted
    found = smooth_sweep(stripes_of(u, np.where(painted, 0.2, 0.05)))
    inside = np.zeros_like(painted)
    inside[::8, 70:110] = True
    error = found.u - truth
    assert 0.9 < rms(found.sigma[inside]) / rms(error[inside]) < 1.1
    assert 0.9 < rms(found.sigma[1::8]) / rms(error[1::8]) < 1.1


@pytest.mark.more
def test_the_lines_of_a_mosaic():
    """Every second line of a mosaic is smoothed as the lines of a plain camera are; a row alone shares nothing."""
    u = (300 + SLOPE * X[:120] + 0.1 * noise_of(0.0)[:, :120]).astype(np.float32)
    u[:, 60] += 5.0
    wide, valid = np.zeros((PROFILES, LINES), np.float32), np.zeros((PROFILES, LINES), bool)
    wide[:, 1::2], valid[:, 1::2] = u, True
    dense = smooth_sweep(stripes_of(u, 0.1))
    sparse = smooth_sweep(stripes_of(wide, 0.1, valid), {0: Sites(first_line=1, line_step=2)})
    np.testing.assert_allclose(sparse.u[:, 1::2], dense.u, rtol=1e-6)
    assert sparse.shared_lines[0, 121] == 1 and np.median(sparse.shared_lines[:, 1::2]) > 15
