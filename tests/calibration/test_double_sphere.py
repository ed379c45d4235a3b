"""A double sphere through the whole calibration: boards all around it, to beyond 180 degrees."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.calibration.first_values import seed_camera
from jaxscan.calibration.other_lens import ray_difference
from jaxscan.calibration.problem import prepare
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import export_camera, load_calibration, save_calibration
from jaxscan.geometry import DoubleSphere


pytestmark = pytest.mark.more


SETTINGS = CalibrationSettings(camera="double_sphere", judge=False)


def wide(world):
    """204 degrees over the height of the image."""
    return world.Rig(focal=(230.0, 230.3), centre=(645.0, 505.0), lens=(-0.18, 0.58))


@pytest.fixture(scope="module")
def perfect(world):
    return world.observe(wide(world), free=14, placements=2, angles=5, seed=10)


@pytest.fixture(scope="module")
def calibrated(world, perfect):
    return calibrate_observations(world.with_noise(perfect, 3), settings=SETTINGS)


def test_first_lens_is_near(world, perfect):
    cameras, _ = seed_camera(prepare(perfect), "double_sphere")
    assert len(cameras) == 2
    rig = wide(world)
    theta = np.linspace(0.05, 1.7, 40)
    ray = np.stack([np.sin(theta), np.zeros(40), np.cos(theta)], -1)
    for camera in cameras:
        seen = np.asarray(jax.vmap(camera.project)(jnp.asarray(ray)))[:, 0] - (rig.size[0] - 1) / 2
        # Centre and aspect are off by some pixels, so the radius is right to a tenth; xi and alpha may be others.
        np.testing.assert_allclose(seen, world.project(rig, ray)[:, 0] - rig.centre[0], rtol=0.1)


def test_errors_are_as_the_covariance_says(world, perfect, calibrated):
    rig, order = wide(world), calibrated.order
    assert isinstance(calibrated.camera, DoubleSphere)
    assert order[:6] == ("fx", "fy", "cx", "cy", "xi", "alpha")
    error, covariance = world.errors(calibrated.scanner, rig), calibrated.covariance
    free = np.diag(covariance) > 0
    assert free[:6].all()
    # Fixed noise; of 20 normal numbers one is beyond 3 once in 19 draws, this draw is not.
    assert np.abs(error[free] / np.sqrt(np.diag(covariance)[free])).max() < 3
    nees = error[free] @ np.linalg.solve(covariance[np.ix_(free, free)], error[free])
    # Chi-squared; four to five numbers are known from priors that are the truth here.
    count = int(free.sum())
    assert count - 5 - 3 * np.sqrt(2 * count) < nees < count + 3 * np.sqrt(2 * count)
    # 1 / sqrt(2 n) of the 3000 corner coordinates is 1.3 %; four of them.
    assert calibrated.quality.corner_rms_whitened == pytest.approx(1.0, abs=0.055)
    # Corners were seen beside the camera and behind its plane: the radius of 90 degrees.
    xi, alpha = rig.lens
    radius = rig.focal[0] / (alpha * np.sqrt(1 + xi**2) + (1 - alpha) * xi)
    assert (np.hypot(*(perfect.corners.q - np.array(rig.centre)).T) > radius).sum() > 50


@pytest.mark.more
def test_the_other_of_two_similar_lenses_is_told_apart(world):
    # A lens with xi = -0.195 is the same to a hundredth of a pixel, and its solve ends there.
    rig = world.Rig(focal=(362.4, 362.9), centre=(645.0, 505.0), lens=(0.29, 0.69))
    observed = world.with_noise(world.observe(rig, free=14, placements=2, angles=5, seed=10), 3)
    camera = calibrate_camera(observed, settings=SETTINGS).camera
    # Sigma of xi is 0.005.
    assert float(camera.distortion[0]) == pytest.approx(0.29, abs=0.02)


def test_where_two_similar_lenses_meet_the_lens_is_no_worse(world):
    """Focal length, xi and alpha may go anywhere together there, to first order, and rays stay where they are."""
    rig = world.Rig(focal=(227.1, 227.1), centre=(479.5, 299.5), lens=(-0.0008, 0.6322), size=(960, 600))
    # About half of the draws end between the two lenses; this one does.
    seen = world.with_noise(world.observe(rig, free=16, placements=0, stripes=False, seed=10), 4)
    free = tuple(block for block in SETTINGS.free if block != "shape")
    found = calibrate_camera(seen, settings=CalibrationSettings(camera="double_sphere", free=free, choose_lens=False))
    assert found.covariance[4, 4] > 0.5**2
    verdict = found.quality.verdict
    assert verdict.usable and verdict.result(verdict.tests[0]) == "passes"
    true = DoubleSphere(227.1, 227.1, 479.5, 299.5, np.array(rig.lens), width=960, height=600)
    assert 0.3 * verdict.good_to.sigma_px < ray_difference(true, found.camera) < 3 * verdict.good_to.sigma_px


def test_points_are_where_ray_and_sheet_meet(world, calibrated):
    rig, scanner = wide(world), calibrated.scanner
    # A point of the sheet beside the camera and one behind its plane, at 1.5 m, seen by the plain forward model.
    n = rig.normal()
    ahead = np.array([0.0, 0.0, 1.0]) - n[2] * n
    ahead = ahead / np.linalg.norm(ahead)
    for tau in np.radians([-98.0, -60.0, 5.0, 70.0, 97.0]):
        p = rig.distances[0] * n + 1.5 * (np.cos(tau) * ahead + np.sin(tau) * np.cross(n, ahead))
        q = jnp.asarray(world.project(rig, p[None])[0])
        range_m, incidence = scanner.laser(0).intersect(scanner.camera.unproject(q))
        found = np.asarray(range_m * scanner.camera.unproject(q))
        # 0.1 px of corner noise, well averaged, leave a few tenths of a millimetre per metre and baseline of 0.2 m.
        assert incidence > 0 and np.linalg.norm(found - p) < 0.015


def test_stored_loaded_and_exported(calibrated, tmp_path):
    save_calibration(calibrated, tmp_path / "c.json")
    back = load_calibration(tmp_path / "c.json")
    for a, b in zip(jax.tree.leaves(back.scanner), jax.tree.leaves(calibrated.scanner), strict=True):
        np.testing.assert_array_equal(a, b)
    export_camera(back, tmp_path / "camchain.yaml", "kalibr")
    assert "camera_model: ds" in (tmp_path / "camchain.yaml").read_text()


def test_names_that_nobody_knows_are_refused():
    for keys in ({"camera": "triple_sphere"}, {"free": ("wings",)}, {"priors": {"wings": 1.0}}):
        with pytest.raises((CalibrationError, TypeError), match=r"triple_sphere|wings"):
            CalibrationSettings(**keys)
        with pytest.raises((CalibrationError, TypeError), match=r"triple_sphere|wings"):
            dataclasses.replace(CalibrationSettings(), **keys)
