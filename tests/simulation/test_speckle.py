"""Speckle against the theory of Gaussian fields: contrast, grain, and the error of a centre."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import dblquad, quad
from scipy.special import j1

from jaxscan.simulation import LaserSpec, RoomSpec, SensorSpec, SimulationConfig
from jaxscan.simulation.camera import Blur
from jaxscan.simulation.light import LitSamples, laser_image, speckle_light


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def field(height, width, level=1.0, psf_px=0.7):
    """Even light over a whole image."""
    rows, columns = np.divmod(np.arange(height * width), width)
    light = np.full((rows.size, 16), level, np.float32)
    return LitSamples(light, rows, columns, (2, 8), (height, width), Blur((psf_px,)))


def coherence(distance, grain):
    """Correlation of the intensity of speckle behind a round aperture: the square of Airy's amplitude."""
    x = np.pi * distance / grain
    return 1.0 if x < 1e-6 else float((2 * j1(x) / x) ** 2)


def averaged(grain, lag=0.0):
    """Covariance of the means of speckle of contrast 1 over two pixels `lag` px apart."""
    cut = 1.22 * 4 * grain + 1  # beyond the fourth ring is less than 1e-3 of the whole

    def within(y, x):
        return (1 - abs(x - lag)) * (1 - abs(y)) * coherence(np.hypot(x, y), grain)

    low, high = max(lag - 1, -cut), min(lag + 1, cut)
    return dblquad(within, low, high, -min(1, cut), min(1, cut), epsabs=1e-4)[0]


@pytest.mark.parametrize(("grain", "contrast"), [(0.38, 1.0), (0.53, 0.3), (0.75, 1.0), (1.5, 0.7), (1.5, 1.0)])
def test_pixels_average_the_contrast_as_theory_has_it(grain, contrast):
    change = speckle_light(field(224, 224), grain, contrast, rng())[8:-8, 8:-8]
    # About one independent value per pixel or per grain; five standard errors of a standard deviation, and 1 %
    # for the finite grid.
    independent = change.size / max(1, 4 / np.pi * grain**2)
    expected = contrast * averaged(grain) ** 0.5
    assert change.std() == pytest.approx(expected, rel=5 * (1 / independent) ** 0.5 + 0.01)
    assert abs(change.mean()) < 5 * expected / independent**0.5
    # Light is never negative.
    assert change.min() >= -1


def test_neighbours_correlate_over_a_grain_and_no_farther():
    grain = 1.5
    change = speckle_light(field(320, 320), grain, 1.0, rng(1))
    for lag in (1, 2, 4, 8):
        # Pairs within one of the parts that are drawn at a time.
        pairs = np.arange(change.shape[1] - lag)
        pairs = pairs[pairs // 16 == (pairs + lag) // 16]
        expected = averaged(grain, lag) / averaged(grain)
        for image in (change, change.T):
            found = (image[:, pairs] * image[:, pairs + lag]).mean() / image.var()
            # Some 30,000 independent values: five standard errors.
            assert found == pytest.approx(expected, abs=0.03), lag


def test_a_record_has_a_pattern_of_its_own_and_a_seed_repeats_it():
    lit, source = field(64, 64), rng(3)
    first, second = (speckle_light(lit, 0.6, 1.0, source) for _ in range(2))
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.08  # 4096 pixels: five standard errors
    np.testing.assert_array_equal(first, speckle_light(lit, 0.6, 1.0, rng(3)))


def _stripe(height, width, psf_px):
    """A thin upright line of light in the middle of the image: its samples are one of eight across."""
    lit = field(height, width, psf_px=psf_px)
    light = np.zeros_like(lit.light)
    light.reshape(-1, 2, 8)[lit.columns == width // 2, :, 4] = 80.0
    return lit._replace(light=light)


@pytest.mark.parametrize(("grain", "contrast", "psf_px"), [(0.53, 0.5, 1.0), (0.8, 1.0, 0.8), (1.5, 1.0, 1.2)])
def test_the_centre_of_a_stripe_errs_as_an_integral_of_its_profile_says(grain, contrast, psf_px):
    height, width = 1600, 48
    lit = _stripe(height, width, psf_px)
    u = np.arange(width)
    change = speckle_light(lit, grain, contrast, rng(5))
    centres = (change * (u - width // 2 - 0.0625)).sum(1) / 10.0
    # var = integral of x x' I(x) I(x') mu^2(x - x', y) over the line and a row's height.
    overlap = quad(
        lambda d: _moments(d, psf_px) * quad(lambda y: (1 - abs(y)) * coherence(np.hypot(d, y), grain), -1, 1)[0],
        -8 * psf_px,
        8 * psf_px,
        limit=200,
    )[0]
    # 1600 rows, neighbours correlate a little: five standard errors of a standard deviation, and 3 % for the
    # integration of a profile of this width by pixels.
    assert centres.std() == pytest.approx(contrast * overlap**0.5, rel=5 / (2 * height / 2) ** 0.5 * 0.5 + 0.03)


def _moments(d, sigma):
    """Integral over x of x (x + d) I(x) I(x + d) of a Gaussian of area 1."""
    return (sigma**2 / 2 - d**2 / 4) * np.exp(-(d**2) / (4 * sigma**2)) / (2 * np.sqrt(np.pi) * sigma)


def test_a_fine_spot_errs_as_much_as_dorsch_says():
    """delta u = C lambda / (2 pi sin u'), here C grain / pi for a spot; a diffuse one errs 1 / sqrt(2) of it.

    A spot that keeps its intensity, and of which speckle takes and gives, has the variance C^2 A / (8 pi) with the
    grain's area A = 4 grain^2 / pi, whatever its width is, so long as it is wider than a grain.
    """
    grain, size = 0.5, 48
    lit = field(size, size, psf_px=1.6)
    light = np.zeros_like(lit.light)
    light[(lit.rows == 24) & (lit.columns == 24)] = 100.0
    lit = lit._replace(light=light)
    u = np.arange(size) - 24.0
    source, centres = rng(9), []
    for _ in range(600):
        spot = speckle_light(lit, grain, 1.0, source)
        centres += [(spot * u).sum() / 100.0, (spot * u[:, None]).sum() / 100.0]
    limit = grain / np.pi
    # 1200 values: five standard errors are 10 %; the spot's own pixel and the spot's width of some grains: 5 %.
    assert np.std(centres) == pytest.approx(limit / 2**0.5, rel=0.15)


def test_the_grain_is_wavelength_times_aperture():
    sensor = SensorSpec(pixel_um=3.45, f_number=4.0)
    laser = LaserSpec(baseline_m=0.4, crossing_m=3.0, wavelength_nm=690.0)
    assert laser.grain_px(sensor) == pytest.approx(0.8)
    green = LaserSpec(baseline_m=0.4, crossing_m=3.0, colour="green")
    assert green.grain_px(sensor) == pytest.approx(0.52 * 4 / 3.45)


def test_dark_images_have_no_speckle():
    lit = field(40, 40, level=0.0)
    assert not speckle_light(lit, 0.5, 1.0, rng()).any()


def test_speckle_of_a_lens_that_softens_is_that_of_its_mean_width():
    """A batch of parts whose pixels have blurs between 0.8 and 1.2 px is drawn with the width of the mean variance."""
    lit = _stripe(320, 48, 1.0)
    place = np.linspace(0, 1, len(lit.rows), dtype=np.float32)
    varied = lit._replace(blur=Blur((0.8, 1.2), place))
    assert varied.blur.mean(np.ones(len(place))) == pytest.approx(((0.8**2 + 1.2**2) / 2) ** 0.5, rel=1e-3)
    change = speckle_light(varied, 0.6, 1.0, rng(4))
    # The light of narrow rows is brighter in its middle, so its speckle is stronger there.
    middle = np.abs(change[:, 24])
    assert middle[:100].mean() > 1.1 * middle[-100:].mean()


def test_a_stripe_is_as_faint_after_speckle_as_before_on_average():
    lit = _stripe(1200, 40, 1.0)
    change = speckle_light(lit, 0.6, 0.5, rng(6))
    plain = laser_image(lit)
    # Rows sum to 10 DN; 1200 rows of a contrast of about 0.2: five standard errors.
    assert change.sum(1).mean() == pytest.approx(0, abs=float(5 * change.sum(1).std() / 1200**0.5))
    assert plain.sum(1).mean() == pytest.approx(10, rel=1e-3)
    assert (plain + change).min() > -0.02 * plain.max()


def test_a_blur_far_below_a_pixel_leaves_light_everywhere():
    added = speckle_light(field(40, 40, level=50.0, psf_px=0.01), 1.0, 0.5, rng(3))
    assert np.isfinite(added).all()
    assert added[8:-8, 8:-8].std() > 1.0


def test_grains_too_large_to_be_drawn_are_refused():
    config = SimulationConfig(room=RoomSpec())
    wide = {**config.model_dump(), "sensor": {"pixel_um": 0.5, "f_number": 64.0}}
    laser = {"baseline_m": 0.4, "crossing_m": 3.0, "wavelength_nm": 2000.0}
    with pytest.raises(ValidationError, match="grains of 256 px, at most 16"):
        SimulationConfig(**{**wide, "laser": [{**laser, "speckle_contrast": 0.5}]})
    assert SimulationConfig(**{**wide, "laser": [laser]}).laser[0].speckle_contrast == 0
