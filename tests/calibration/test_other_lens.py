"""Another model of the lens is tried where the chosen one falls short, and only there."""

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, advise_lens, calibrate_camera


PINHOLE = CalibrationSettings(free=tuple(b for b in CalibrationSettings().free if b != "shape"))


def test_a_fisheye_that_was_taken_for_a_pinhole(world):
    """A lens of 130 degrees: pinhole leaves pixels, fisheye none, and its first line of advice says so."""
    rig = world.Rig(focal=(420.0, 420.0), lens=(0.02, -0.01, 0.0, 0.0), spread=0.6)
    seen = world.with_noise(world.observe(rig, free=24, placements=0, stripes=False, tilt_deg=25.0), 0)
    found = calibrate_camera(seen, settings=PINHOLE)
    advice = advise_lens(found, PINHOLE).quality.verdict.advice
    assert advice[1:] == found.quality.verdict.advice
    words, before, after = advice[0].split("`")[1], *(float(text) for text in advice[0].split()[-4:-1:2])
    assert words in ("--lens fisheye", "--lens double_sphere", "--free rational")
    assert before == pytest.approx(found.quality.corner_rms_px, rel=0.1)
    # The noise is 0.1 px in each direction.
    assert after == pytest.approx(0.1 * np.sqrt(2), rel=0.15)


def test_a_lens_that_suffices_is_left_alone(world, monkeypatch):
    seen = world.with_noise(world.observe(world.Rig(), free=12, placements=0, stripes=False), 0)
    found = calibrate_camera(seen, settings=PINHOLE)
    monkeypatch.setattr("jaxscan.calibration.other_lens.calibrate_observations", lambda *_, **__: pytest.fail())
    assert advise_lens(found, PINHOLE) is found
