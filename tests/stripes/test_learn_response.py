"""Responses: by any exponent, and learned from two exposures of one scene."""

import numpy as np
import pytest

from jaxscan.stripes import ExposurePair, decode_table, known_response, learn_response


def scene(seed=1):
    """A smooth picture of many levels [DN], from dark to bright."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:240, 0:320] / 60.0
    waves = sum(np.sin(a * u + b * v + c) for a, b, c in rng.uniform(-3, 3, (9, 3)))
    waves = (waves - waves.min()) / np.ptp(waves)
    return 4.0 + 190.0 * waves**2


def taken(level, response, rng):
    """An image as a camera codes it: shot and read noise, the response, rounding."""
    level = np.clip(level + rng.normal(size=level.shape) * np.sqrt(0.3 + level / 40), 0, 255)
    return np.rint(np.interp(level, decode_table(response)[0], np.arange(256))).astype(np.uint8)


def exposed(response, ratio, seed=2):
    rng = np.random.default_rng(seed)
    return ExposurePair(taken(scene() / ratio, response, rng), taken(scene(), response, rng), ratio)


@pytest.mark.parametrize("ratio", [1.5, 4.0])
@pytest.mark.parametrize("response", ["linear", "srgb"])
def test_a_named_response_is_recognised(response, ratio):
    learned = learn_response([exposed(response, ratio)])
    assert learned.response == response
    # Noise of a hundred thousand pixels and the rounding of codes.
    assert learned.misfit < 0.5
    assert response == "linear" or learned.linear_misfit > 5.0


@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
@pytest.mark.parametrize("gamma", [1.5, 1.8, 2.2, 2.6])
def test_an_exponent_is_found(gamma, ratio):
    learned = learn_response([exposed(f"gamma {gamma}", ratio)])
    kind, found = learned.response.split()
    # The exponents that are tried are 0.02 apart.
    assert kind == "gamma" and abs(float(found) - gamma) <= 0.05


def test_several_pairs_count_together():
    pairs = [exposed("gamma 2.2", ratio, seed) for seed, ratio in enumerate((2.0, 3.0, 8.0))]
    assert abs(float(learn_response(pairs).response.split()[1]) - 2.2) <= 0.03


def test_images_that_tell_nothing():
    dark = np.zeros((50, 60), np.uint8)
    assert learn_response([]) is None
    assert learn_response([ExposurePair(dark, dark, 2.0)]) is None
    assert learn_response([exposed("srgb", 1.1)]) is None


def test_a_curve_of_another_kind_shows_in_the_misfit():
    """A camera that adds a black level of 30 codes fits no exponent."""
    rng = np.random.default_rng(4)
    short, long = (np.clip(taken(scene() / r, "linear", rng) + 30.0, 0, 255).astype(np.uint8) for r in (2.0, 1.0))
    assert learn_response([ExposurePair(short, long, 2.0)]).misfit > 1.0


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2])
def test_the_table_of_an_exponent(gamma):
    level, slope = decode_table(f"gamma {gamma}")
    np.testing.assert_allclose(level, 255 * (np.arange(256) / 255) ** gamma)
    np.testing.assert_allclose(slope[20:-1], np.gradient(level)[20:-1], rtol=2e-3)


@pytest.mark.parametrize("name", ["gamma", "gamma 0.5", "gamma 9", "gamma nan", "gamma 2.2 ", "log", "", "x" * 9999])
def test_other_responses_are_refused(name):
    with pytest.raises(ValueError, match=r'^found ".{0,60}", expected "linear", "srgb" or "gamma 2.2"'):
        known_response(name)
    with pytest.raises(ValueError, match="expected"):
        decode_table(name)
