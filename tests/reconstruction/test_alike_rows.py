"""Sweeps whose rows err alike, as demosaicing and compression make them: what is left on flat surfaces is stated."""

import cv2
import numpy as np
import pytest

from jaxscan.reconstruction.along import smooth_sweep
from jaxscan.stripes import ProfileRows, extract_stripes, mosaic_wave, scatter_law
from jaxscan.stripes.correlation import INDEPENDENT, REACH, SLOPES, Correlation, tables_of

from .test_along_surfaces import rms, stripes_of


LINES, PROFILES, WIDTH = 192, 64, 96
X = np.arange(LINES)
UPRIGHT = np.arange(PROFILES) % 2 == 1
SLOPE = np.where(UPRIGHT, np.linspace(-0.01, 0.01, PROFILES), np.linspace(0.27, 0.35, PROFILES))[:, None]
FLAT = 48 + SLOPE * (X - 95.5) + np.random.default_rng(3).uniform(-6, 6, (PROFILES, 1))
OF_A_JPEG = (0.8, 0.63, 0.48, 0.35, 0.2, 0.1)


def alike(lags, shape, seed=1):
    """Noise of variance 1 with such a correlation of the next rows."""
    size = 1024
    covariance = np.zeros(size)
    covariance[0] = 1.0
    for k, value in enumerate(lags, 1):
        covariance[k] = covariance[-k] = value
    power = np.maximum(np.fft.fft(covariance).real, 0)
    drawn = np.fft.fft(np.random.default_rng(seed).normal(size=(shape[0], size)))
    return np.fft.ifft(drawn * np.sqrt(power / power.mean())).real[:, : shape[1]]


def ratio(found, truth, rows=np.s_[:]):
    return rms((found.u - truth)[rows]) / rms(found.sigma[rows])


@pytest.mark.more
@pytest.mark.parametrize("lags", [(), (0.65, 0.2), OF_A_JPEG])
def test_rows_that_are_alike_over_several_lines(lags):
    found = smooth_sweep(stripes_of(FLAT + 0.1 * alike(lags, FLAT.shape), 0.1))
    assert 0.85 < ratio(found, FLAT) < 1.2
    # The mean of a line is as good as its rows say, and its points.
    inside = np.s_[:, 20:-20]
    error, count = rms((found.u - FLAT)[inside].mean(1)), FLAT[inside].shape[1]
    for variance in (found.sigma**2 * found.shared_lines, found.sigma_row**2):
        # 64 means: 9 %.
        assert 0.75 < error / np.sqrt(variance[inside].mean() / count) < 1.3


@pytest.mark.more
def test_an_error_by_the_place_on_a_mosaic():
    """Two pixels apart it is the same: an upright stripe has it on all of its lines, and only steep ones show it. As
    demosaicing does, rows are mixed: noise becomes alike, and the error of steep stripes less."""
    x = np.arange(-1, LINES + 1)
    on_all = FLAT[:, :1] + SLOPE * x
    drawn = 0.16 * alike((), on_all.shape) + 0.17 * np.sin(np.pi * on_all)
    found = smooth_sweep(stripes_of(FLAT + 0.25 * drawn[:, :-2] + 0.5 * drawn[:, 1:-1] + 0.25 * drawn[:, 2:], 0.1))
    assert 0.85 < ratio(found, FLAT, UPRIGHT) < 1.2
    assert 0.7 < ratio(found, FLAT, ~UPRIGHT) < 1.2


def test_the_error_of_a_mosaic_is_taken_back():
    """Steep stripes show it, and upright ones have it too; rows without one are left as they are."""
    noise = 0.02 * alike((), FLAT.shape)
    place = FLAT + 0.2 * np.sin(np.pi * FLAT)
    ones = np.ones(FLAT.shape, np.float32)
    rows = lambda u: ProfileRows(u.astype(np.float32), 0.02 * ones, ones > 0, 50 * ones)
    assert mosaic_wave(rows(FLAT + noise), ()) is None
    wave = mosaic_wave(rows(place + noise), ())
    assert rms(wave.error - (place - FLAT)) < 0.02
    found = smooth_sweep(stripes_of(place + noise, 0.02))
    assert rms(found.u - FLAT) < 0.03


def test_brighter_neighbours_pull_a_slanted_stripe():
    """The lens mixes lines: light of a blurred stripe comes from brighter lines too."""
    fine, blur, peak = 4, 1.0, 120.0
    line, across = np.mgrid[: LINES * fine, : WIDTH * fine] / fine - 0.5 + 0.5 / fine
    slope, change = 0.3, 0.02
    true = 20.0 + slope * np.arange(LINES)
    light = np.exp(change * (line - LINES / 2)) * np.exp(-0.5 * ((across - 20.0 - slope * line) / 0.4) ** 2)
    light = cv2.GaussianBlur(light, (0, 0), blur * fine).reshape(LINES, fine, WIDTH, fine).mean((1, 3))
    light *= peak / light.max()
    rng = np.random.default_rng(1)
    seen = lambda part: np.clip(np.rint(40 + part * light + rng.normal(size=(32, *light.shape))), 0, 255)
    stripes = extract_stripes(*(seen(part).astype(np.uint8) for part in (1.0, 0.0)))
    bright = (light.max(1) > 0.3 * peak) & (np.arange(LINES) > 10) & (np.arange(LINES) < LINES - 10)
    error = lambda u: float(np.mean((np.asarray(u) - true)[:, bright & np.asarray(stripes.valid).all(0)]))
    assert abs(error(stripes.u)) > 0.004
    assert abs(error(smooth_sweep(stripes).u)) < 0.25 * abs(error(stripes.u))


def frames(kind, width, peak_dn):
    """Laser-on and laser-off frames rgb8 of the flat surface."""
    rng = np.random.default_rng(1)
    red = peak_dn * np.exp(-0.5 * ((np.arange(WIDTH) - FLAT[..., None]) / width) ** 2)

    def developed(light):
        level = 40.0 + np.stack([light, 0.08 * light, 0.03 * light], -1)
        noise = np.sqrt(1.0 + level / 40.0) * rng.normal(size=level.shape)
        seen = np.clip(np.rint(level + noise), 0, 255).astype(np.uint8)
        if kind == "direct":
            return seen
        mosaic = seen[..., 1].copy()
        mosaic[:, ::2, ::2], mosaic[:, 1::2, 1::2] = seen[:, ::2, ::2, 0], seen[:, 1::2, 1::2, 2]
        found = [cv2.cvtColor(one, cv2.COLOR_BayerRGGB2BGR) for one in mosaic]
        if kind == "jpeg":
            found = [cv2.imdecode(cv2.imencode(".jpg", one, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], 1) for one in found]
        return np.stack(found)[..., ::-1].copy()

    return developed(red), developed(0.0 * red)


@pytest.mark.more
@pytest.mark.parametrize(
    ("kind", "width", "peak_dn"), [("direct", 1.2, 120), ("demosaiced", 1.2, 120), ("jpeg", 1.2, 120)]
)
def test_frames_of_a_colour_camera(kind, width, peak_dn):
    stripes = extract_stripes(*frames(kind, width, peak_dn), pixel_format="rgb8")
    good = np.asarray(stripes.valid) & (np.abs(np.asarray(stripes.u) - FLAT) < 2)
    assert good.mean() > 0.99
    assert 0.85 < ratio(smooth_sweep(stripes), FLAT, good) < 1.2


def test_rows_alike_by_the_surface_are_no_error():
    """Relief is not mistaken for a correlation."""
    truth = FLAT + 0.3 * np.sin(2 * np.pi * (X / 60 + np.linspace(0, 1, PROFILES)[:, None]))
    rows = stripes_of(truth + 0.05 * alike((), FLAT.shape), 0.05)
    law = scatter_law(ProfileRows(rows.u, rows.sigma, rows.valid, rows.amplitude))
    assert law.correlation == INDEPENDENT and np.all(
        law.of(ProfileRows(rows.u, rows.sigma, rows.valid, rows.amplitude)).scale < 1.06
    )


@pytest.mark.more
def test_tables_are_those_of_fits():
    lags, size, left, right = (0.6, 0.3, 0.1), 10, REACH, 4
    # Ten lines on either side, of which one ends after four.
    low, high = 2 * size - right, right
    x = np.arange(-low, high + 1)
    noise = alike(lags, (40_000, len(x)))
    design = np.stack([np.ones(len(x)), x, x**2], 1)
    fit = np.linalg.pinv(design)
    residual = noise - noise @ fit.T @ design.T
    tables = tables_of(Correlation(lags))
    place = left * (REACH + 1) + right
    for slope in range(len(SLOPES)):
        inflation, mean, spread, _ = tables.windows[2, slope * (REACH + 1) ** 2 + place]
        # 40 000 draws: 1 %.
        assert np.var(noise @ fit[0]) / np.sum(fit[0] ** 2) == pytest.approx(inflation, rel=0.03)
        chi2, freedom = np.sum(residual**2, 1), len(x) - 3
        assert chi2.mean() / freedom == pytest.approx(mean, rel=0.02)
        assert chi2.std() / np.sqrt(2 * freedom) == pytest.approx(spread, rel=0.03)


def test_independent_rows_have_tables_of_ones():
    tables = tables_of(INDEPENDENT)
    assert not tables.correlated
    # The other half is of errors by a mosaic alone.
    for table in (
        tables.windows[:, : tables.windows.shape[1] // 2],
        tables.edges[: len(tables.edges) // 2],
        tables.rows[: len(SLOPES)],
    ):
        np.testing.assert_allclose(table, 1.0, atol=1e-6)
