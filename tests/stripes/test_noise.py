"""Noise from the frames themselves, against the sensor's own numbers."""

import numpy as np
import pytest

from jaxscan.stripes import LaserLine, NoiseModel, estimate_noise


def _texture(rows=480, columns=640):
    v, u = np.indices((rows, columns))
    smooth = 70 + 50 * np.sin(u / 37.0) * np.cos(v / 23.0)
    return smooth + 30 * ((u // 5 + v // 7) % 2)


@pytest.mark.parametrize(("read", "gain"), [(1.0, 40.0), (2.0, 10.0), (3.0, 5.0)])
def test_pair_over_a_textured_scene(read, gain, profile, sensor):
    camera = sensor(read, gain)
    texture = _texture()
    stripe = profile(np.full(480, 300.0), 2.0, 120.0, 640)
    noise = estimate_noise(camera.expose(texture + stripe)[None], camera.expose(texture)[None])
    # 1e5 samples in a dozen bins: 1 to 4 %, the more the less a number weighs in the variance.
    assert noise.read_dn == pytest.approx(read, rel=0.1)
    assert noise.electrons_per_dn == pytest.approx(gain, rel=0.1)


def test_scattered_light_is_no_noise(profile, sensor):
    camera = sensor(1.0, 40.0)
    texture = _texture()
    glow = profile(np.full(480, 300.0), 2.0, 120.0, 640) + profile(np.full(480, 300.0), 90.0, 12.0, 640)
    noise = estimate_noise(camera.expose(texture + glow)[None], camera.expose(texture)[None])
    assert noise.read_dn == pytest.approx(1.0, rel=0.1)
    assert noise.electrons_per_dn == pytest.approx(40.0, rel=0.1)


def test_without_laser_off_frame(sensor):
    camera = sensor(1.5, 20.0)
    v, u = np.indices((480, 640))
    smooth = 80 + 60 * np.sin(u / 60.0) * np.cos(v / 50.0)
    noise = estimate_noise(camera.expose(smooth)[None], None)
    assert noise.read_dn == pytest.approx(1.5, rel=0.1)
    assert noise.electrons_per_dn == pytest.approx(20.0, rel=0.1)


def test_one_level_leaves_the_gain_at_its_default(sensor):
    camera = sensor(1.0, 40.0)
    flat = np.full((480, 640), 20.0)
    noise = estimate_noise(camera.expose(flat)[None], camera.expose(flat)[None])
    assert noise.electrons_per_dn == NoiseModel().electrons_per_dn
    assert noise.read_dn == pytest.approx(1.0, rel=0.1)


def test_dark_or_noiseless_frames_give_usable_numbers():
    black = np.zeros((1, 480, 640), np.uint8)
    assert estimate_noise(black, black) == NoiseModel()
    grey = np.full((1, 480, 640), 100, np.uint8)
    noise = estimate_noise(grey, grey)
    assert 0 < noise.read_dn < 1
    assert noise.electrons_per_dn >= NoiseModel().electrons_per_dn
    tiny = np.full((1, 2, 3), 100, np.uint8)
    assert estimate_noise(tiny, tiny) == NoiseModel()
    assert estimate_noise(tiny) == NoiseModel()


def test_bayer_and_rgb_look_at_the_lasers_channel(sensor):
    camera, other = sensor(2.0, 10.0), sensor(8.0, 1.0)
    texture = _texture()
    expose = lambda: np.stack([camera.expose(texture), other.expose(texture), other.expose(texture)], -1)[None]
    noise = estimate_noise(expose(), expose(), pixel_format="rgb8", line=LaserLine(colour="red"))
    assert noise.read_dn == pytest.approx(2.0, rel=0.1)
    red = np.zeros((480, 640), bool)
    red[::2, ::2] = True
    mosaic = lambda: np.where(red, camera.expose(texture), other.expose(texture))[None]
    noise = estimate_noise(mosaic(), mosaic(), pixel_format="bayer_rggb8", line=LaserLine(colour="red"))
    # A quarter of the samples: twice the scatter of the pair above.
    assert noise.read_dn == pytest.approx(2.0, rel=0.15)
    assert noise.electrons_per_dn == pytest.approx(10.0, rel=0.15)
