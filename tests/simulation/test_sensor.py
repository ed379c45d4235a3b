"""The sensor: statistics of its noise, its response, its mosaic."""

import numpy as np
import pytest

from jaxscan.simulation import SensorSpec, expose
from jaxscan.simulation.camera import encode_srgb, mosaic


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


@pytest.mark.parametrize("level", [0.0, 3.0, 40.0, 200.0])
def test_noise_has_the_variance_of_the_model(level):
    sensor = SensorSpec(electrons_per_dn=25.0, read_dn=1.5)
    count = 200_000
    sample = expose(np.full(count, level, np.float32), sensor, rng()).astype(float)
    variance = sensor.read_dn**2 + level / sensor.electrons_per_dn + 1 / 12
    if level >= 3 * variance**0.5 + 1:
        # Five standard errors of mean and variance.
        assert sample.mean() == pytest.approx(level, abs=5 * (variance / count) ** 0.5)
        assert sample.var() == pytest.approx(variance, rel=5 * (2 / count) ** 0.5)
    else:
        # Near black the sensor clips at zero: brighter on average, and never negative.
        assert sample.mean() > level and sample.var() < variance
    assert (expose(np.full(9, -50, np.float32), sensor, rng()) == 0).all()


def test_bright_light_saturates():
    sensor = SensorSpec()
    image = expose(np.array([100.0, 300.0, 1e5], np.float32), sensor, rng())
    assert image.dtype == np.uint8
    assert image[0] < 150 and image[1] == 255 and image[2] == 255


@pytest.mark.parametrize(
    ("pixel_format", "sites"),
    [("bayer_rggb8", "RGGB"), ("bayer_bggr8", "BGGR"), ("bayer_grbg8", "GRBG"), ("bayer_gbrg8", "GBRG")],
)
def test_the_mosaic_takes_the_sites_of_its_name(pixel_format, sites):
    image = np.ones((3, 5, 7), np.float32) * np.array([1, 2, 3], np.float32)[:, None, None]
    value = {"R": 1, "G": 2, "B": 3}
    out = mosaic(image, pixel_format)
    assert out.shape == (5, 7)
    np.testing.assert_array_equal(out[:2, :2].ravel(), [value[letter] for letter in sites])
    np.testing.assert_array_equal(out[2:4, 4:6], out[:2, :2])


def test_the_srgb_curve_is_the_standard_s():
    # IEC 61966-2-1: 18 % grey is 118 of 255; the ends stay; the two pieces meet.
    values = encode_srgb(np.array([0.0, 0.18 * 255, 255.0, 0.0031308 * 255], np.float32))
    np.testing.assert_allclose(values, [0, 117.6, 255, 12.92 * 0.0031308 * 255], atol=0.1)
    image = expose(np.full(1000, 0.18 * 255, np.float32), SensorSpec(response="srgb", read_dn=0.1), rng())
    assert abs(image.mean() - 117.6) < 0.3


def test_the_black_level_is_added_to_everything():
    count = 100_000
    for level in (0.0, 60.0):
        sensor = SensorSpec(electrons_per_dn=8.0, read_dn=1.7, black_dn=9.0)
        sample = expose(np.full(count, level, np.float32), sensor, rng()).astype(float)
        variance = 1.7**2 + level / 8 + 1 / 12
        # Five standard errors. The black level has no shot noise.
        assert sample.mean() == pytest.approx(level + 9, abs=5 * (variance / count) ** 0.5)
        assert sample.var() == pytest.approx(variance, rel=5 * (2 / count) ** 0.5)
