"""Laser-off frames that are predicted from laser-on frames."""

import numpy as np
import pytest

from jaxscan.stripes import PIXEL_FORMATS, LaserLine, extract_stripes, laser_plane, predict_off
from jaxscan.stripes.predict import put_plane


ROWS, COLUMNS = 200, 256
CROSSTALK = 0.04


def scene(sensor, peak, *, hue=(1.0, 0.8, 0.6), seed=0):
    """A printed surface of one hue under a red stripe: laser-on and laser-off frame, and the stripe's place."""
    rng, camera = np.random.default_rng(seed), sensor(seed=seed)
    # Print of 12 px and of 4 px squares, dark and light.
    coarse, fine = (np.kron(rng.uniform(0.3, 1.0, (99, 99)), np.ones((n, n)))[:ROWS, :COLUMNS] for n in (12, 4))
    light = 90.0 * (coarse * fine)[..., None] * np.asarray(hue)
    u = 120.0 + 0.2 * np.arange(ROWS)
    stripe = peak * np.exp(-0.5 * ((np.arange(COLUMNS)[None, :] - u[:, None]) / 1.5) ** 2)
    laser = stripe[..., None] * np.array([1.0, CROSSTALK, CROSSTALK])
    return camera.expose(light + laser)[None], camera.expose(light)[None], u


def errors(stripes, u):
    valid = np.asarray(stripes.valid)[0]
    return np.abs(np.asarray(stripes.u)[0] - u), valid


@pytest.mark.more
@pytest.mark.parametrize("peak", [60.0, 150.0, 700.0])
def test_other_channels_are_nearly_as_good_as_a_laser_off_frame(sensor, peak):
    on, off, u = scene(sensor, peak)
    error, valid = errors(extract_stripes(on, off, pixel_format="rgb8"), u)
    without, found = errors(extract_stripes(on, pixel_format="rgb8"), u)
    mono, seen = errors(extract_stripes(np.ascontiguousarray(on[..., 0])), u)
    good, best, plain = found & (without < 1), valid & (error < 1), seen & (mono < 1)
    assert best.mean() > 0.97
    assert good.mean() > 0.95 * best.mean()
    assert np.median(without[good]) < 2.0 * np.median(error[best])
    # The laser's channel alone takes the print for stripes, unless the stripe outshines it by far.
    assert peak > 500 or plain.mean() < good.mean() - 0.1


def test_the_prediction_is_the_laser_off_frame(sensor):
    on, off, _ = scene(sensor, 150.0)
    predicted = predict_off(on, "rgb8", LaserLine())
    # The noise of two frames and of the mixture of two channels: 2 to 3 DN.
    difference = predicted[0, :, :, 0].astype(float) - off[0, :, :, 0]
    assert np.sqrt(np.mean(difference**2)) < 5.0
    # The other channels are as they were: they give the colour of a point.
    np.testing.assert_array_equal(predicted[..., 1:], on[..., 1:])


def test_where_the_stripe_is_clipped_the_other_channels_are_taken_along_the_line(sensor):
    # Crosstalk of 80 DN over a surface of 20: taken for surface, it would swallow the stripe's flanks.
    even = np.full((ROWS, COLUMNS, 3), 20.0)
    u = 128.0 + 0.1 * np.arange(ROWS)
    stripe = 2000.0 * np.exp(-0.5 * ((np.arange(COLUMNS)[None, :] - u[:, None]) / 1.5) ** 2)
    on = sensor().expose(even + stripe[..., None] * np.array([1.0, CROSSTALK, CROSSTALK]))[None]
    predicted = predict_off(on, "rgb8", LaserLine())
    assert np.abs(predicted.astype(float) - 20.0).mean((0, 1, 2)).max() < 1.5
    assert predicted.max() < 30
    error, valid = errors(extract_stripes(on, pixel_format="rgb8"), u)
    assert valid.mean() > 0.99 and np.max(error[valid]) < 0.3


@pytest.mark.parametrize("pixel_format", ["rgb8", "bayer_rggb8"])
def test_each_channel_alone_leaves_the_laser_in_all(sensor, pixel_format):
    # A white line on an even grey surface: the other channels take it all away.
    u = 100.0 + 0.2 * np.arange(ROWS)
    stripe = 120.0 * np.exp(-0.5 * ((np.arange(COLUMNS)[None, :] - u[:, None]) / 1.5) ** 2)
    on = sensor().expose(np.repeat((40.0 + stripe)[..., None], 3, 2))[None]
    on = on if pixel_format == "rgb8" else np.ascontiguousarray(on[..., 0])
    together, alone = (predict_off(on, pixel_format, LaserLine(), alone=one).astype(float) for one in (False, True))
    # A running median of 25 samples with read noise.
    assert np.abs(alone - 40.0).mean() < 2.0
    if pixel_format == "rgb8":
        assert together[..., 0].max() > 100.0


@pytest.mark.parametrize("axis", ["rows", "columns"])
@pytest.mark.parametrize("colour", ["red", "green", "blue"])
@pytest.mark.parametrize("pixel_format", PIXEL_FORMATS)
def test_a_plane_goes_back_to_where_it_came_from(pixel_format, colour, axis):
    rng, line = np.random.default_rng(0), LaserLine(colour=colour, stripe_axis=axis)
    shape = (2, 7, 9, 3) if pixel_format == "rgb8" else (2, 7, 9)
    frames, others = (rng.integers(0, 256, shape, dtype=np.uint8) for _ in range(2))
    plane = np.array(laser_plane(others, pixel_format=pixel_format, line=line))
    written = frames.copy()
    put_plane(written, plane, pixel_format=pixel_format, line=line)
    np.testing.assert_array_equal(laser_plane(written, pixel_format=pixel_format, line=line), plane)
    # Nothing else was touched.
    assert np.count_nonzero(written != frames) <= plane.size


def test_a_frame_is_predicted_alone(sensor):
    frames = np.concatenate([scene(sensor, 100.0, seed=seed)[0] for seed in range(3)])
    together = predict_off(frames, "rgb8", LaserLine())
    alone = np.concatenate([predict_off(frame[None], "rgb8", LaserLine()) for frame in frames])
    np.testing.assert_array_equal(together, alone)
