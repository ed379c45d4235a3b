"""Noise from the frames themselves, against the sensor's own numbers."""

import functools

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


ROWS, COLUMNS = 512, 640
SENSORS = [(0.5, 100.0), (3.0, 5.0)]


def _drawn_once(make):
    """Light that many tests use, and none may change."""

    @functools.cache
    def kept(*words):
        light = make(*words)
        light.flags.writeable = False
        return light

    return kept


@_drawn_once
def _flat(level=10.0):
    return np.full((2, ROWS, COLUMNS), level)


@_drawn_once
def _scene():
    return np.stack([_texture(ROWS, COLUMNS)] * 2)


@_drawn_once
def _stripe(profile, frames=2):
    course = 200 + 100 * np.sin(np.arange(ROWS) / 90.0)
    return np.stack([profile(course + 3 * i, 1.6, 100.0, COLUMNS) for i in range(frames)])


@_drawn_once
def _reflections(profile, share=0.2, amplitude=100.0, width=1.6):
    """A second stripe at random places of so many rows."""
    rng = np.random.default_rng(7)
    one = lambda: profile(rng.uniform(20, COLUMNS - 20, ROWS), width, amplitude, COLUMNS)
    return np.stack([one() * (rng.random(ROWS) < share)[:, None] for _ in range(2)])


def _variance_is_right(noise, camera, levels, rel=0.1):
    told = [noise.read_dn**2 + level / noise.electrons_per_dn for level in levels]
    assert told == pytest.approx([camera.read_dn**2 + level / camera.electrons_per_dn for level in levels], rel=rel)


@pytest.mark.parametrize(("read", "gain"), SENSORS)
@pytest.mark.parametrize(("amplitude", "width"), [(100.0, 1.6), (100.0, 7.0), (12.0, 3.0)])
def test_second_stripes_are_no_noise(read, gain, amplitude, width, profile, sensor):
    camera = sensor(read, gain)
    light = _stripe(profile) + _reflections(profile, 0.2, amplitude, width)
    noise = estimate_noise(camera.expose(_flat() + light), camera.expose(_flat()))
    # 1e5 samples of one level: half a per cent, and what a stripe leaves beyond the margins.
    _variance_is_right(noise, camera, [10.0], rel=0.04)
    # No light has these levels but that of the stripes.
    assert noise.electrons_per_dn == NoiseModel().electrons_per_dn


def _brighter(on, off):
    return 1.1 * on, off


def _darker(on, off):
    return 0.9 * on, off


def _moved(on, off):
    """A textured box on 5 % of each frame that moved by two pixels between the two."""
    box = np.random.default_rng(8).uniform(20, 200, (29, 36)).repeat(4, 0).repeat(4, 1)
    on, off = on.copy(), off.copy()
    on[:, 100:216, 300:444] = box
    off[:, 102:218, 302:446] = box
    return on, off


def _half_clipped(on, off):
    on = on.copy()
    on[:, :, COLUMNS // 2 :] = 400.0
    return on, on


@pytest.mark.parametrize("change", [_brighter, _darker, _moved, _half_clipped])
@pytest.mark.parametrize(("read", "gain"), SENSORS)
def test_what_flickers_moves_or_is_clipped_is_no_noise(read, gain, change, profile, sensor):
    camera, light = sensor(read, gain), _stripe(profile) + _reflections(profile)
    for scene, levels in ((_flat(), [10.0]), (_scene(), [30.0, 70.0, 130.0])):
        on, off = change(scene, scene)
        _variance_is_right(estimate_noise(camera.expose(on + light), camera.expose(off)), camera, levels, rel=0.05)


@pytest.mark.parametrize(("read", "gain"), SENSORS)
def test_two_levels_tell_the_gain(read, gain, profile, sensor):
    camera, light = sensor(read, gain), _stripe(profile) + _reflections(profile)
    scene = _flat().copy()
    scene[:, :, COLUMNS // 2 :] = 90.0
    noise = estimate_noise(camera.expose(scene + light), camera.expose(scene))
    _variance_is_right(noise, camera, [10.0, 90.0], rel=0.04)
    assert noise.electrons_per_dn == pytest.approx(gain, rel=0.1)


def test_stripes_in_the_dark_leave_the_default(profile, sensor):
    camera, light = sensor(1.0, 40.0), _stripe(profile) + _reflections(profile)
    assert estimate_noise(camera.expose(light), camera.expose(_flat(0.0))) == NoiseModel()


def test_restless_levels_do_not_outvote_the_others(sensor):
    # Half of the picture trembles; a line through both would pass below zero at the quiet half.
    camera, rng = sensor(1.0, 40.0), np.random.default_rng(9)
    scene = _flat(20.0).copy()
    scene[:, :, COLUMNS // 2 :] = 60.0
    restless = lambda: scene + 8.0 * rng.normal(size=scene.shape) * (scene > 40)
    noise = estimate_noise(camera.expose(restless()), camera.expose(restless()))
    _variance_is_right(noise, camera, [20.0], rel=0.1)


def test_no_gain_that_no_sensor_has(sensor):
    scene = _flat(60.0).copy()
    scene[:, :, COLUMNS // 2 :] = 130.0
    camera = sensor(1.0, 0.2)
    noise = estimate_noise(camera.expose(scene), camera.expose(scene))
    assert noise.electrons_per_dn == NoiseModel().electrons_per_dn
    # What is seen is not denied, but put down to the read noise.
    assert 60.0 / 0.2 < noise.read_dn**2 < 130.0 / 0.2


def test_srgb_frames_in_linear_levels(profile):
    read, gain = 1.0, 20.0
    rng, light = np.random.default_rng(10), _stripe(profile) + _reflections(profile)

    def expose(level):
        noisy = rng.poisson(level * gain) / gain + read * rng.normal(size=level.shape)
        linear = np.clip(noisy / 255.0, 0.0, 1.0)
        code = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        return np.round(255.0 * code).astype(np.uint8)

    noise = estimate_noise(expose(_scene() + light), expose(_scene()), response="srgb")
    assert noise.read_dn == pytest.approx(read, rel=0.1)
    assert noise.electrons_per_dn == pytest.approx(gain, rel=0.1)


def test_reflections_without_laser_off_frame(profile, sensor):
    camera = sensor(1.0, 40.0)
    noise = estimate_noise(camera.expose(_flat() + _stripe(profile) + _reflections(profile)))
    _variance_is_right(noise, camera, [10.0], rel=0.04)
