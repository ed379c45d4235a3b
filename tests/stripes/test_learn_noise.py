"""Noise of a frame learned with a line on the rest, and images that are not as a sensor makes them."""

import cv2
import numpy as np
import pytest

from jaxscan.stripes import FrameFormat, LaserLine, NoiseModel, extract_stripes, learn_noise


LINEAR = FrameFormat("mono8", "linear")
ROWS, COLUMNS = 300, 400


def _expose(light, rng, read=1.7, gain=8.0, black=5.0):
    level = rng.poisson(gain * light) / gain + black + read * rng.normal(size=light.shape)
    return np.clip(np.rint(level), 0, 255)


def _pairs(darkest=20.0, *, shadow=False, code=lambda level: level, **sensor):
    """A room of soft shades, in the shadow part of which there is no light at all."""
    rng = np.random.default_rng(0)
    light = np.linspace(darkest, 170.0, COLUMNS)[None, :] * np.ones((ROWS, 1))
    if shadow:
        light[:, 20:60] = 0.0
    return tuple(np.stack([code(_expose(light, rng, **sensor)) for _ in range(4)]).astype(np.uint8) for _ in "ab")


FEW_ELECTRONS = {"read": 1.0, "gain": 4.0, "black": 16.0}


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


def test_a_black_level_above_the_picture_is_refused():
    on, off = _pairs()
    with pytest.raises(ValueError, match=r"black level is 250 DN.*at 1\d\d DN or below.*covered lens"):
        extract_stripes(on, off, noise=NoiseModel(1.7, 8.0, black_dn=250.0))


@pytest.mark.parametrize("darkest", [4.0, 40.0])
def test_a_high_black_level_does_not_bend_the_line_of_the_noise(darkest):
    # Few electrons and a black level of 16 DN: the line passes zero noise at 12 DN.
    learned = _learn(*_pairs(darkest, **FEW_ELECTRONS))
    assert learned.noise.electrons_per_dn == pytest.approx(4.0, rel=0.05)
    for level in (max(20.0, darkest), 60.0, 100.0, 170.0):
        assert learned.noise.variance(level) == pytest.approx(1.0 + (level - 16.0) / 4.0 + 1 / 12, rel=0.1)
    (unknown,) = learned.unknown
    assert unknown.startswith("black level (1") and learned.noise.black_dn < 16.0


def test_a_high_black_level_that_a_shadow_shows():
    learned = _learn(*_pairs(40.0, shadow=True, **FEW_ELECTRONS))
    assert learned.noise.black_dn == pytest.approx(16.0, abs=0.5)
    assert learned.noise.read_dn == pytest.approx(1.0, rel=0.1)
    assert learned.unknown == ()


@pytest.mark.parametrize(("quality", "axis"), [(60, "rows"), (85, "columns"), (95, "rows"), (95, "columns")])
def test_blocks_of_jpeg_are_said(quality, axis):
    frames = [_through_jpeg(a, quality) for a in _pairs()]
    (doubt,) = learn_noise(*frames, frames=LINEAR, line=LaserLine(stripe_axis=axis)).doubts
    assert "JPEG" in doubt and "PNG" in doubt


def test_of_a_capture_that_says_jpeg_blocks_are_not_said_again():
    on, off = (_through_jpeg(a, 85) for a in _pairs())
    assert learn_noise(on, off, frames=LINEAR, line=LaserLine(), compressed=True).doubts == ()


@pytest.mark.parametrize("flicker", [1.02, 1.3])
@pytest.mark.parametrize("pattern", ["bars", "squares", "noise"])
def test_bars_and_squares_of_eight_pixels_are_no_jpeg(pattern, flicker):
    rng = np.random.default_rng(3)
    row, column = np.arange(ROWS)[:, None] // 8, np.arange(COLUMNS)[None, :] // 8
    dark = {"bars": column % 2 + 0 * row, "squares": (row + column) % 2, "noise": 0 * (row + column)}[pattern]
    light = np.linspace(40.0, 150.0, COLUMNS)[None, :] * np.where(dark, 0.3, 1.0)
    on, off = (np.stack([_expose(factor * light, rng) for _ in range(4)]).astype(np.uint8) for factor in (flicker, 1.0))
    assert _learn(on, off).doubts == ()


@pytest.mark.more
def test_a_black_level_is_compared_with_levels_not_codes():
    # Code 100 of sRGB is a level of 32.5 DN.
    rng = np.random.default_rng(0)
    on, off = (np.clip(rng.normal(100.0, 1.0, (2, 40, 60)), 0, 255).astype(np.uint8) for _ in "ab")
    srgb = FrameFormat("mono8", "srgb")
    with pytest.raises(ValueError, match=r"black level is 60 DN.*at 3\d\.?\d* DN or below"):
        extract_stripes(on, off, pixel_format=srgb, noise=NoiseModel(1.0, 40.0, black_dn=60.0))
    # Codes that are levels lie above it.
    extract_stripes(on, off, noise=NoiseModel(1.0, 40.0, black_dn=60.0))


def test_a_dark_room_at_its_black_level_is_not_refused():
    rng = np.random.default_rng(0)
    on, off = (np.rint(5.0 + 0.2 * rng.normal(size=(2, 40, 60))).astype(np.uint8) for _ in "ab")
    extract_stripes(on, off, noise=NoiseModel(0.3, 8.0, black_dn=5.0))


def test_reasons_stand_where_no_speckle_is_learned():
    learned = _learn(*_pairs(shadow=True))
    assert learned.words(NoiseModel(1.7, 8.0, 5.0), "set to 0").endswith("; not learned: speckle (set to 0)")
