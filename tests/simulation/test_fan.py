"""The laser's light across its sheet and along its fan: lobes, ripples, and a width that changes."""

from functools import partial

import numpy as np
import pytest

from jaxscan.simulation import expect_record, make_rig
from jaxscan.simulation.light.lit import along
from tests.simulation import plain
from tests.simulation.plain import WIDTH, F, scene_of, wall


HEIGHT, CY = 180, 90.3
Z, BASE, CROSSING, WAIST = 2.0, 0.3, 2.0, 0.003


def config(**laser):
    """A sheet of 3 mm whose fan spans 60 degrees."""
    return plain.config(HEIGHT, {"fan_deg": 60.0, "waist_mm": 1000 * WAIST, "divergence_mrad": 0.0, **laser})


def before_a_wall(**laser):
    """A record of a wall that faces the camera at 2 m."""
    return expect_record(make_rig(config(**laser)), scene_of(partial(wall, z=Z)), 0.0)


def moments(image):
    """Sum, mean and variance of the light in every row."""
    image, u = image.astype(float), np.arange(WIDTH)
    total = image.sum(1)
    mean = image @ u / total
    return total, mean, (image * (u - mean[:, None]) ** 2).sum(1) / total


SLANT = (1 / BASE) / np.hypot(1 / BASE, 1 / CROSSING)
"""Cosine between the sheet's normal and the wall."""
SIGMA_PX = WAIST / SLANT * F / Z
INSIDE = slice(8, -8)


def angles():
    """Angle in the fan that lights each row of the wall: it grows upwards."""
    return np.arctan((CY - np.arange(HEIGHT)) * Z / F / np.hypot(Z, BASE))


@pytest.mark.parametrize("lobes", [(0.1, 0.0), (0.0, 0.05), (0.08, 0.08)])
def test_lobes_stand_beside_the_sheet(lobes):
    plain, lobed = before_a_wall(), before_a_wall(side_lobes=lobes, lobes_at=4.0)
    for before, after in zip(moments(plain.laser), moments(lobed.laser), strict=True):
        assert before.shape == after.shape
    total, mean, variance = (np.mean(part[INSIDE]) for part in moments(lobed.laser))
    total0, mean0, variance0 = (np.mean(part[INSIDE]) for part in moments(plain.laser))
    whole = 1 + sum(lobes)
    assert total / total0 == pytest.approx(whole, rel=1e-3)
    # The sheet's normal points to larger u.
    shift = 4 * SIGMA_PX * (lobes[1] - lobes[0]) / whole
    assert mean - mean0 == pytest.approx(shift, abs=2e-3)
    assert variance - variance0 == pytest.approx((4 * SIGMA_PX) ** 2 * sum(lobes) / whole - shift**2, abs=5e-3)
    # The truth is the middle of the sheet, not of its light.
    np.testing.assert_array_equal(plain.truth.u, lobed.truth.u)


def test_the_line_is_wider_towards_its_ends():
    _, _, plain = moments(before_a_wall().laser)
    _, _, wide = moments(before_a_wall(widening=1.5).laser)
    factor = 1 + 1.5 * (angles() / np.deg2rad(30)) ** 2
    np.testing.assert_allclose((wide - plain)[INSIDE], (SIGMA_PX**2 * (factor**2 - 1))[INSIDE], rtol=0.02, atol=4e-3)


def test_brightness_changes_slowly_and_finely_along_the_line():
    plain = moments(before_a_wall().laser)[0]
    slow = moments(before_a_wall(uneven_slow=0.3).laser)[0] / plain
    # From crest to trough, and smooth: rows are 0.16 degrees apart.
    assert slow[INSIDE].max() - slow[INSIDE].min() > 0.4
    assert np.abs(slow - 1).max() <= 0.3 + 1e-3
    assert np.abs(np.diff(slow[INSIDE])).max() < 0.02
    fine = moments(before_a_wall(uneven_fine=0.1, fine_deg=1.5).laser)[0] / plain
    sheet = make_rig(config(uneven_fine=0.1, fine_deg=1.5)).sheets[0]
    # The lens blurs waves of fifteen rows by half a per cent.
    np.testing.assert_allclose(fine[INSIDE], along(sheet, angles().astype(np.float32))[INSIDE], atol=6e-3)


def test_fine_changes_have_the_variance_and_the_length_that_were_asked():
    sheet = make_rig(config(uneven_fine=0.1, fine_deg=0.01)).sheets[0]
    angle = np.deg2rad(np.linspace(-20, 20, 40_001)).astype(np.float32)
    wave = along(sheet, angle).astype(float) - 1
    # Thousands of waves of 24 lengths: a few per cent.
    assert wave.std() == pytest.approx(0.1, rel=0.05)
    steps = [(wave[lag:] @ wave[:-lag]) / (wave @ wave) for lag in (2, 10, 60)]
    assert steps[0] > 0.85 and steps[1] < 0.7 and abs(steps[2]) < 0.4
