"""Frames of more than 8 bits from the camera to the capture, with a simulated camera."""

import numpy as np
import pytest
from scanrig.cameras import open_camera
from scanrig.cameras.camera import CameraSettings
from scanrig.cameras.simulated import FrameShape, SyntheticScene, draw
from scanrig.checks import prove_pair
from scanrig.session.plan import frame_bytes

from jaxscan.files.capture import open_capture, verify_capture
from jaxscan.stripes import DEEP_FORMATS, LaserLine, level_exposures, to_8_bits

from .desk import Desk, rig_config


FAINT = SyntheticScene(peak_dn=3.0, ambient_dn=2.0, read_dn=0.1, electrons_per_dn=40.0)


def settings(pixel_format, **other):
    return CameraSettings(kind="simulated", width=128, height=96, pixel_format=pixel_format, trigger="free", **other)


@pytest.mark.parametrize("pixel_format", DEEP_FORMATS)
def test_a_simulated_camera_gives_the_same_light_in_finer_steps(pixel_format):
    layout, bits = DEEP_FORMATS[pixel_format]
    with open_camera(settings(pixel_format)) as camera, open_camera(settings(layout)) as plain:
        camera.start()
        plain.start()
        deep, byte = camera.next(1.0), plain.next(1.0)
    assert deep.image.dtype == np.uint16 and deep.bits == bits and byte.shown is byte.image
    np.testing.assert_array_equal(deep.shown, to_8_bits(deep.image, bits))
    # Both are rounded from one drawing of the noise, and the deep one twice.
    assert np.abs(deep.shown.astype(int) - byte.image).max() <= 1
    # Samples between those of 8 bits are there.
    assert np.count_nonzero(deep.image % (1 << bits - 8)) > 0.5 * deep.image.size


def test_formats_and_responses_that_no_camera_has_are_refused():
    with pytest.raises(ValueError, match='found "mono11", expected one of mono8, rgb8'):
        settings("mono11")
    with pytest.raises(ValueError, match='response: found "srgb", but frames of 12 bits are "linear"'):
        settings("mono12", response="srgb")


@pytest.mark.parametrize("pixel_format", ["mono12", "bayer_rggb16"])
def test_a_sweep_keeps_all_bits(tmp_path, pixel_format):
    layout, bits = DEEP_FORMATS[pixel_format]
    handed = []
    desk = Desk(camera={"pixel_format": pixel_format})
    result = desk.sweep(tmp_path / "room", on_pair=lambda number, angle, on, off: handed.append((on, off)))
    assert result.status == "complete" and verify_capture(tmp_path / "room") == []
    capture = open_capture(tmp_path / "room")
    assert (capture.pixel_format, capture.bits, capture.exposures) == (layout, bits, level_exposures(bits))
    for number, pair in enumerate(handed):
        # Pages and previews have 8 bits: the level of the whole range.
        for shown, kept in zip(pair, capture.frames(number), strict=True):
            assert shown.dtype == np.uint8
            np.testing.assert_array_equal(shown, kept[0])


def test_a_sweep_of_12_bits_is_resumed_and_compared(tmp_path):
    desk = Desk(camera={"pixel_format": "mono12"})
    taken = []
    desk.sweep(tmp_path / "room", on_pair=lambda number, *_: taken.append(number), should_stop=lambda: len(taken) > 3)
    result = desk.sweep(tmp_path / "room", resume=True)
    assert result.status == "complete" and len(open_capture(tmp_path / "room")) == 10


def test_a_proof_sees_faint_lines_at_full_depth():
    def proof(bits):
        generator = np.random.default_rng(0)
        shape = FrameShape(640, 512, "mono8", bits)
        on, off = (draw(FAINT, 100.0, lit, shape, generator) for lit in (1, 0))
        return prove_pair(on, off, pixel_format="mono8", response="linear", line=LaserLine(), bits=bits)

    deep = proof(12)
    assert deep.ok and deep.lit_lines > 0.95
    # In DN of 8 bits, whatever the camera gives.
    assert deep.peak_dn == pytest.approx(3.0, rel=0.1) and deep.ambient_dn == pytest.approx(2.0, rel=0.1)


def test_space_is_reckoned_for_all_levels():
    plain, deep = rig_config(), rig_config(camera={"pixel_format": "mono12"})
    assert frame_bytes(deep) == 3 * frame_bytes(plain)
