"""The laser's channel, learned from pairs of frames."""

import numpy as np
import pytest

from jaxscan.stripes.frames.learn_colour import learn_colour


FORMATS = ["rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"]
COLOURS = ["red", "green", "blue"]
ROWS, COLUMNS = 120, 200


def mosaic(pictures, pixel_format):
    """What a sensor of this format keeps of pictures [frames, rows, columns, 3]."""
    if pixel_format == "rgb8":
        return pictures
    tile = pixel_format[6:10]
    plane = np.empty(pictures.shape[:3])
    for site, letter in enumerate(tile):
        i, j = divmod(site, 2)
        plane[:, i::2, j::2] = pictures[:, i::2, j::2, "rgb".index(letter)]
    return plane


def pairs(
    sensor, profile, pixel_format, colour, *, share=0.3, amplitude=60.0, flicker=1.0, lit=1.0, frames=3, rows=True
):
    """Pairs of a room of warm light and colourful texture, with a laser that the other channels see too."""
    sensor = sensor(seed=3)
    rng = sensor.rng
    room = np.array([50.0, 35.0, 15.0]) * rng.uniform(0.4, 1.6, (ROWS, COLUMNS, 3))
    u = 90 + 20 * np.sin(np.arange(ROWS) / 15)
    stripe = profile(u, 2.0, amplitude, COLUMNS)
    stripe[int(lit * ROWS) :] = 0.0
    seen = np.where(np.array(COLOURS) == colour, 1.0, share)
    on = flicker * room + stripe[:, :, None] * seen
    if not rows:
        on, room = on.swapaxes(0, 1), room.swapaxes(0, 1)
    many = lambda a: np.broadcast_to(a, (frames, *a.shape))
    return tuple(sensor.expose(mosaic(many(a), pixel_format)) for a in (on, room))


@pytest.mark.parametrize("pixel_format", FORMATS)
@pytest.mark.parametrize("colour", COLOURS)
def test_each_colour_in_each_format(sensor, profile, pixel_format, colour):
    assert learn_colour(*pairs(sensor, profile, pixel_format, colour), pixel_format) == colour


@pytest.mark.parametrize("pixel_format", ["rgb8", "bayer_rggb8"])
@pytest.mark.parametrize("flicker", [0.8, 1.2])
def test_lamps_that_flicker_are_no_laser(sensor, profile, pixel_format, flicker):
    # A red room, brighter by 20 % in one frame, and a blue laser.
    found = learn_colour(*pairs(sensor, profile, pixel_format, "blue", flicker=flicker), pixel_format)
    assert found == "blue"
    with pytest.raises(ValueError, match="No channel"):
        learn_colour(*pairs(sensor, profile, pixel_format, "blue", flicker=flicker, amplitude=0.0), pixel_format)


@pytest.mark.parametrize("colour", COLOURS)
def test_a_stripe_that_saturates_every_channel(sensor, profile, colour):
    frames = pairs(sensor, profile, "rgb8", colour, amplitude=2000.0, share=0.3)
    assert np.all(frames[0].max((0, 1, 2)) == 255)
    assert learn_colour(*frames, "rgb8") == colour


def test_a_stripe_on_few_lines_and_along_the_rows(sensor, profile):
    assert learn_colour(*pairs(sensor, profile, "bayer_grbg8", "green", lit=0.1), "bayer_grbg8") == "green"
    frames = pairs(sensor, profile, "bayer_grbg8", "blue", rows=False)
    assert learn_colour(*frames, "bayer_grbg8", stripe_axis="columns") == "blue"


@pytest.mark.parametrize("pixel_format", ["rgb8", "bayer_rggb8"])
def test_frames_without_a_laser(sensor, profile, pixel_format):
    on, off = pairs(sensor, profile, pixel_format, "red", amplitude=0.0, frames=12)
    with pytest.raises(ValueError, match="No channel"):
        learn_colour(on, off, pixel_format)
    with pytest.raises(ValueError, match="No channel"):
        learn_colour(np.zeros_like(on), np.zeros_like(on), pixel_format)
    lit, dark = pairs(sensor, profile, pixel_format, "red")
    with pytest.raises(ValueError, match="exchanged"):
        learn_colour(dark, lit, pixel_format)


def test_a_mono_camera_has_one_channel():
    frames = np.zeros((1, 8, 8), np.uint8)
    assert learn_colour(frames, frames, "mono8") == "red"


def test_frames_that_do_not_fit_the_format():
    frames = np.zeros((1, 8, 8), np.uint8)
    with pytest.raises(ValueError, match="4 dimensions"):
        learn_colour(frames, frames, "rgb8")
    with pytest.raises(ValueError, match="shape"):
        learn_colour(frames, frames[:, :4], "bayer_rggb8")
    with pytest.raises(ValueError, match="uint8"):
        learn_colour(frames.astype(float), frames.astype(float), "bayer_rggb8")
