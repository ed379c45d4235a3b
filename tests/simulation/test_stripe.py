"""The rendered stripe against closed forms: position, motion and shadows."""

from functools import partial

import numpy as np
import pytest

from jaxscan.simulation import CameraSpec, LaserSpec, SensorSpec, expect_record, make_rig
from jaxscan.simulation.camera import psf_weights
from jaxscan.simulation.scene import Material, stripes
from tests.simulation import plain
from tests.simulation.plain import CX, F, scene_of, wall


CY = 30.3


def rig_of(**changes):
    return make_rig(plain.config(60, {"waist_mm": 1.5}, **changes))


def column(z: float) -> float:
    """Where the sheet X / 0.3 + Z / 2 = 1 cuts the depth z, in a camera without distortion."""
    return F * 0.3 * (1 - z / 2.0) / z + CX


def centroid(record) -> np.ndarray:
    """Centre of the light in every row."""
    light = record.laser.astype(np.float64)
    return light @ np.arange(light.shape[1]) / light.sum(1)


def test_on_a_wall_the_stripe_is_where_the_closed_form_says():
    """Centroid and truth, at depths that put it at many places of a pixel: no locking to the grid."""
    rig = rig_of()
    depths = np.linspace(1.5, 2.7, 23)
    error = []
    for z in depths:
        record = expect_record(rig, scene_of(partial(wall, z=float(z))), 0.0)
        assert record.truth.valid.all()
        # Casting in float32 leaves the depth 5e-7 m uncertain: 1e-4 px.
        np.testing.assert_allclose(record.truth.u, column(z), atol=3e-4)
        np.testing.assert_allclose(record.truth.xyz[:, 0], z, atol=2e-6)
        error.append(centroid(record)[5:-5] - column(z))
    error = np.array(error)
    # The sheet is seen at a slant, so the light's centroid is not its centre exactly: over the
    # stripe's 1 px, depth of illumination 1/(r w) and the pixel's scale change by less than 1 %.
    assert np.abs(error).max() < 0.005
    # The rest must not follow the place within the pixel (23 places; 1 px locking is 0.3 px).
    phase = 2 * np.pi * (np.array([column(z) for z in depths]) % 1)
    waves = np.stack([np.cos(phase), np.sin(phase), np.ones_like(phase), depths], -1)
    cosine, sine, *_ = np.linalg.lstsq(waves, error.mean(1), rcond=None)[0]
    assert np.hypot(cosine, sine) < 5e-4


def test_the_profile_is_sheet_and_lens_and_pixel_together():
    """Variance of the profile: sheet (seen at this slant), PSF and pixel add up."""
    for psf in (0.5, 0.9):
        rig = rig_of(sensor=SensorSpec(psf_px=psf))
        record = expect_record(rig, scene_of(partial(wall, z=2.0)), 0.0)
        light = record.laser[30].astype(np.float64)
        u = np.arange(len(light))
        mean = light @ u / light.sum()
        variance = light @ (u - mean) ** 2 / light.sum()
        normal = rig.sheets[0].normal
        # Along the row, the wall's points leave the sheet by n_x per metre.
        sheet = 1.5e-3 / normal[0] * F / 2.0
        # The PSF is cut off at 4 standard deviations and the fan's r changes over the stripe: 1 %.
        assert variance == pytest.approx(sheet**2 + psf**2 + 1 / 12, rel=0.01)


def test_the_peak_on_the_reference_wall_is_as_configured():
    laser = LaserSpec(baseline_m=0.3, crossing_m=2.0, waist_mm=1.5, focus_m=2.0, peak_dn=100.0, range_m=2.0)
    camera = CameraSpec(width=160, height=60, fx=F, fy=F, cx=80.0, cy=CY)
    record = expect_record(rig_of(laser=laser, camera=camera), scene_of(partial(wall, z=2.0)), 0.0)
    # The wall faces the camera, not quite the laser.
    assert record.truth.amplitude[30] == pytest.approx(100, rel=0.06)
    assert record.truth.amplitude[30] == record.laser[30].max()


def test_light_falls_off_with_distance_and_slant():
    """Total light in a row: 1 / r from the fan, z from the pixel's footprint, cosine, albedo."""
    rig = rig_of()
    origin = rig.sheets[0].origin

    def total(z: float, slope: float, albedo: float) -> tuple[float, float]:
        material = Material(((albedo,) * 3,))
        record = expect_record(rig, scene_of(partial(wall, z=z, slope=slope, material=material)), 0.0)
        row = round(CY)
        y, x = record.truth.xyz[row, 1], record.truth.xyz[row, 0]
        leg = np.array([-y, -record.truth.xyz[row, 2], x]) - origin
        r = np.linalg.norm(leg)
        normal = np.array([slope, 0, -1]) / np.hypot(slope, 1)
        cosine = -leg @ normal / r
        # Depth along the row runs as the wall does; the sheet's offset per pixel gives the width.
        u = record.truth.u[row]
        n = rig.sheets[0].normal
        per_pixel = []
        for du in (-0.5, 0.5):
            tx = (u + du - CX) / F
            depth = z / (1 - slope * tx)
            per_pixel.append(depth * (n[0] * tx + n[2]))
        return float(record.laser[row].sum()), albedo * cosine / r / abs(per_pixel[1] - per_pixel[0])

    measured, expected = zip(
        *(total(*case) for case in ((2.0, 0.0, 0.7), (1.6, 0.0, 0.7), (2.0, 0.5, 0.7), (2.2, -0.6, 0.2))), strict=True
    )
    # Second-order terms over the width of the stripe.
    np.testing.assert_allclose(np.array(measured) / measured[0], np.array(expected) / expected[0], rtol=0.01)


def test_a_thing_before_the_wall_hides_stripe_and_casts_a_shadow():
    rig = rig_of(laser=LaserSpec(baseline_m=0.3, crossing_m=2.0, waist_mm=1.0))
    both = expect_record(rig, scene_of(partial(wall, z=2.4), partial(wall, z=1.6, left=0.0, right=0.5)), 0.0)
    # Seen from the laser, everything behind the near plate is dark: one stripe only, on the plate.
    assert both.truth.valid.all()
    np.testing.assert_allclose(both.truth.u, column(1.6), atol=1e-3)
    assert both.laser[:, : int(column(2.4)) + 6].sum() == 0
    # A plate that blocks the light but does not reach into the stripe's view leaves no stripe at all:
    # it stands between laser and wall, beside the line of sight.
    plate = partial(wall, z=0.6, left=0.12, right=0.3)
    blocked = expect_record(rig, scene_of(partial(wall, z=2.4), plate), 0.0)
    assert column(0.6) > 160 + 5, "the plate's own stripe is outside the image"
    assert not blocked.truth.valid.any()
    assert blocked.laser.sum() == 0
    assert (blocked.truth.u == 0).all() and (blocked.truth.xyz == 0).all()


def test_light_bleeds_across_a_depth_edge():
    """A stripe cut by an edge in its middle: the lens smears the rest, the centroid moves."""
    rig = rig_of()
    x = 0.3 * (1 - 2.0 / 2.0)
    cut = expect_record(rig, scene_of(partial(wall, z=2.0, left=x, right=3.0)), 0.0)
    whole = expect_record(rig, scene_of(partial(wall, z=2.0)), 0.0)
    assert cut.laser.sum() == pytest.approx(whole.laser.sum() / 2, rel=0.02)
    # Half a Gaussian of standard deviation s has its mean at s sqrt(2 / pi).
    sheet = 1.5e-3 / rig.sheets[0].normal[0] * F / 2.0
    shift = centroid(cut)[30] - centroid(whole)[30]
    assert shift == pytest.approx(sheet * np.sqrt(2 / np.pi), rel=0.05)
    # Light arrives on pixels beyond the edge, where there is nothing.
    assert cut.laser[30, int(CX) - 1] > 0.02 * cut.laser[30].max()


def test_albedo_is_that_of_the_laser_s_colour():
    rig = rig_of()
    red, blue = Material(((0.8, 0.1, 0.1),)), Material(((0.1, 0.1, 0.8),))
    on_red, on_blue = (expect_record(rig, scene_of(partial(wall, z=2.0, material=m)), 0.0) for m in (red, blue))
    assert on_red.laser.sum() == pytest.approx(8 * on_blue.laser.sum(), rel=1e-4)
    printed = Material(((0.8,) * 3, (0.2,) * 3), partial(stripes, period=0.04))
    striped = expect_record(rig, scene_of(partial(wall, z=2.0, material=printed, slope=0.8)), 0.0)
    assert striped.truth.valid.all()


def test_the_sheet_s_bow_moves_the_stripe():
    bowed = LaserSpec(baseline_m=0.3, crossing_m=2.0, waist_mm=1.5, bow=(0.05, 0.02))
    record = expect_record(rig_of(laser=bowed), scene_of(partial(wall, z=2.0)), 0.0)
    rig = rig_of(laser=bowed)
    sheet = rig.sheets[0]
    y = (np.arange(60) - CY) / F * 2.0
    x = (record.truth.u - CX) / F * 2.0
    offset = 2.0 * sheet.slope_at(x / 2, y / 2) - sheet.distance
    np.testing.assert_allclose(offset, 0, atol=2e-6)
    assert np.ptp(record.truth.u) > 0.02
    np.testing.assert_allclose(centroid(record)[5:-5], record.truth.u[5:-5], atol=0.005)


def test_a_horizontal_stripe_has_one_centre_per_column():
    laser = LaserSpec(normal=(0.0, 1 / 0.3, 1 / 2.0), distance_m=1.0, stripe_axis="columns", waist_mm=1.5)
    record = expect_record(rig_of(laser=laser), scene_of(partial(wall, z=2.0)), 0.0)
    assert record.truth.u.shape == (160,)
    assert record.truth.valid.all()
    np.testing.assert_allclose(record.truth.u, CY, atol=3e-4)
    light = record.laser.astype(np.float64)
    np.testing.assert_allclose(np.arange(60) @ light / light.sum(0), CY, atol=0.005)


@pytest.mark.parametrize("psf", [0.4, 0.8, 1.5])
def test_the_lens_conserves_light_and_place(psf):
    weights = psf_weights(psf, 8).astype(np.float64)
    pixels = np.arange(len(weights)) - len(weights) // 2
    at = (np.arange(8) + 0.5) / 8 - 0.5
    np.testing.assert_allclose(weights.sum(0), 1 / 8, rtol=1e-6)
    # The mean of what a sample spreads over pixels is its own place, but for what sampling a
    # Gaussian of this width by pixels aliases, exp(-2 (pi psf)^2) / pi or 0.014 px at 0.4, and
    # for what is cut off at four standard deviations.
    alias = np.exp(-2 * (np.pi * psf) ** 2) / np.pi
    np.testing.assert_allclose(8 * (pixels @ weights), at, atol=1.05 * alias + 2.5e-4)
