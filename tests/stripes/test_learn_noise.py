"""Noise of a frame learned with a line on the rest, and images that are not as a sensor makes them."""

import cv2
import numpy as np
import pytest

from jaxscan.stripes import FrameFormat, LaserLine, NoiseModel, extract_stripes, learn_noise


LINEAR = FrameFormat("mono8", "linear")
ROWS, COLUMNS = 300, 400


def _expose(light, rng, black=5.0):
    level = rng.poisson(8.0 * light) / 8.0 + black + 1.7 * rng.normal(size=light.shape)
    return np.clip(np.rint(level), 0, 255)


def _pairs(darkest=20.0, *, shadow=False, code=lambda level: level, seed=0):
    """A room of soft shades, in the shadow part of which there is no light at all."""
    rng = np.random.default_rng(seed)
    light = np.linspace(darkest, 170.0, COLUMNS)[None, :] * np.ones((ROWS, 1))
    if shadow:
        light[:, 20:60] = 0.0
    frames = [np.stack([code(_expose(light, rng)) for _ in range(4)]).astype(np.uint8) for _ in range(2)]
    return frames[0], frames[1]


def _learn(on, off, frames=LINEAR):
    return learn_noise(on, off, frames=frames, line=LaserLine())


def test_black_level_gain_and_read_noise_of_a_room_with_a_shadow():
    learned = _learn(*_pairs(shadow=True))
    # Means of five pixels: 0.8 DN each, of thousands; the edges of the shadow pull by some tenths.
    assert learned.noise.black_dn == pytest.approx(5.0, abs=0.5)
    assert learned.noise.electrons_per_dn == pytest.approx(8.0, rel=0.1)
    # Without its black level read noise would be 1.5 DN.
    assert learned.noise.read_dn == pytest.approx(1.7, abs=0.12)
    assert learned.unknown == () and learned.doubts == ()
    line = learned.words(NoiseModel(1.7, 8.0, 5.0, speckle=0.05))
    assert line == "read noise 1.7 DN, 8 electrons per DN, black level 5 DN, speckle 5 % of a pixel"


def test_a_black_level_that_no_surface_shows_is_said_to_be_unknown():
    learned = _learn(*_pairs())
    assert learned.noise.black_dn == 0.0
    assert any(one.startswith("black level (at most 2") for one in learned.unknown)
    assert "not learned: black level" in learned.words(learned.noise)
    # The sum of both noises holds at every level that there is.
    for level in (30.0, 100.0, 170.0):
        assert learned.noise.variance(level) == pytest.approx(1.7**2 + (level - 5.0) / 8.0 + 1 / 12, rel=0.06)


def test_an_even_wall_tells_a_sum_only():
    rng = np.random.default_rng(0)
    on, off = (
        np.stack([_expose(np.full((ROWS, COLUMNS), 80.0), rng) for _ in range(4)]).astype(np.uint8) for _ in "ab"
    )
    learned = _learn(on, off)
    assert any("one level only" in one for one in learned.unknown)
    assert any(one.startswith("black level") for one in learned.unknown)


def test_gamma_in_a_linear_capture_is_said():
    code = lambda level: np.rint(255.0 * (level / 255.0) ** (1 / 2.2))
    on, off = _pairs(code=code)
    (doubt,) = _learn(on, off).doubts
    assert "gamma" in doubt and 'response "linear"' in doubt and "srgb" in doubt
    assert _learn(on, off, FrameFormat("mono8", "gamma 2.2")).doubts == ()


def _through_jpeg(frames, quality):
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return np.stack([cv2.imdecode(cv2.imencode(".jpg", frame, options)[1], cv2.IMREAD_GRAYSCALE) for frame in frames])


@pytest.mark.parametrize("quality", [60, 85])
def test_blocks_of_jpeg_are_said(quality):
    on, off = _pairs()
    (doubt,) = _learn(_through_jpeg(on, quality), _through_jpeg(off, quality)).doubts
    assert "JPEG" in doubt and "PNG" in doubt


def test_a_black_level_above_the_picture_is_refused():
    on, off = _pairs()
    with pytest.raises(ValueError, match=r"black level is 250 DN.*at 1\d\d DN or below.*covered lens"):
        extract_stripes(on, off, noise=NoiseModel(1.7, 8.0, black_dn=250.0))
