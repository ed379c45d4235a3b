"""Another model of the lens is tried where the chosen one falls short, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, advise_lens, calibrate_camera


PINHOLE = CalibrationSettings(free=tuple(b for b in CalibrationSettings().free if b != "shape"))


def seen_by_a_fisheye(world, views=30, focal=400.0):
    """Corners of boards within 65 degrees of the axis of an equidistant fisheye, without noise."""
    random, rig = np.random.default_rng(5), world.Rig()
    corners = rig.board.corners()
    corners = corners - corners.mean(0)
    q = []
    while len(q) < views:
        theta, turn = np.radians(55.0 * np.sqrt(random.random())), random.uniform(0, 2 * np.pi)
        away = world.rodrigues(theta * np.array([-np.sin(turn), np.cos(turn), 0.0]))
        tilt = world.rodrigues(random.uniform(-0.5, 0.5, 3))
        p = (corners @ tilt.T + [0.0, 0.0, random.uniform(0.5, 0.8)]) @ away.T
        radius = np.linalg.norm(p[:, :2], axis=1, keepdims=True)
        seen = np.array(rig.centre) + focal * np.arctan2(radius, p[:, 2:]) * p[:, :2] / radius
        if (seen > 5).all() and (seen < np.array(rig.size) - 6).all():
            q.append(seen)
    template = world.observe(rig, free=views, placements=0, stripes=False)
    return replace(template, corners=replace(template.corners, q=np.array(q)))


def test_a_fisheye_that_was_taken_for_a_pinhole(world):
    """The pinhole falls short; another model does not, and the first line of advice says so."""
    seen = seen_by_a_fisheye(world)
    found = calibrate_camera(world.with_noise(seen, 0), settings=PINHOLE)
    advice = advise_lens(found, PINHOLE).quality.verdict.advice
    assert advice[1:] == found.quality.verdict.advice
    words, (before, after) = advice[0].split("`")[1], (float(advice[0].split()[place]) for place in (-4, -2))
    assert words in ("--lens fisheye", "--lens double_sphere", "--free rational")
    assert before == pytest.approx(found.quality.corner_rms_px, rel=0.1)
    # The noise is 0.1 px in each direction.
    assert after == pytest.approx(0.1 * np.sqrt(2), rel=0.15)


def test_a_lens_that_suffices_is_left_alone(world, monkeypatch):
    seen = world.with_noise(world.observe(world.Rig(), free=12, placements=0, stripes=False), 0)
    found = calibrate_camera(seen, settings=PINHOLE)
    monkeypatch.setattr("jaxscan.calibration.other_lens.calibrate_observations", lambda *_, **__: pytest.fail())
    assert advise_lens(found, PINHOLE) is found
