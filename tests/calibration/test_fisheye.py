"""A fisheye through the whole calibration: boards all around it, and OpenCV's solve of the same corners."""

from dataclasses import replace

import cv2
import jax
import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.calibration.settings import PRIORS
from jaxscan.geometry import Fisheye


SETTINGS = CalibrationSettings(camera="fisheye")
FLAT = tuple(block for block in SETTINGS.free if block != "warp")


def wide(world, **changes):
    """195 degrees over the height of the image."""
    return world.Rig(focal=(305.0, 305.4), centre=(645.0, 505.0), lens=(-0.02, 0.003, -0.001, 1e-4), **changes)


def normalised(calibration, error):
    free = np.diag(calibration.covariance) > 0
    return error[free] / np.sqrt(np.diag(calibration.covariance)[free]), error[free] @ np.linalg.solve(
        calibration.covariance[np.ix_(free, free)], error[free]
    )


@pytest.fixture(scope="module")
def perfect(world):
    return world.observe(wide(world), free=14, placements=2, angles=5, seed=10)


@pytest.mark.slow
def test_perfect_data_recover_the_truth(world, perfect):
    calibration = calibrate_observations(perfect, settings=SETTINGS)
    assert isinstance(calibration.camera, Fisheye)
    # Rounding of float64 pixels only; what the priors pull is scaled down with the noise.
    assert np.abs(world.errors(calibration.scanner, wide(world))).max() < 1e-6
    assert calibration.order[:8] == ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    assert calibration.quality.corners_rejected == 0
    # Corners were seen beside the camera and behind its plane: pi / 2 lies at this radius.
    t, (k1, k2, k3, k4) = np.pi / 2, wide(world).lens
    radius = 305.0 * (t + k1 * t**3 + k2 * t**5 + k3 * t**7 + k4 * t**9)
    assert (np.hypot(*(perfect.corners.q - np.array(wide(world).centre)).T) > radius).sum() > 50


@pytest.mark.slow
def test_errors_are_as_the_covariance_says(world, perfect):
    total, count = 0.0, 0
    for seed in range(4):
        calibration = calibrate_observations(world.with_noise(perfect, seed), settings=SETTINGS)
        single, nees = normalised(calibration, world.errors(calibration.scanner, wide(world)))
        # The largest of 4 x 20 normal numbers is beyond 4.5 once in 2000 times.
        assert np.abs(single).max() < 4.5
        total, count = total + nees, count + len(single)
        # 1 / sqrt(2 n) of the 3000 corner coordinates is 1.3 %, of the 800 stripe points 2.5 %; four of them.
        assert calibration.quality.corner_rms_whitened == pytest.approx(1.0, abs=0.055)
        assert calibration.quality.stripe_rms_whitened == pytest.approx(1.0, abs=0.10)
    # Chi-squared; four to five numbers per solve are known from priors that are the truth here.
    assert count - 5 * 4 - 4 * np.sqrt(2 * count) < total < count + 4 * np.sqrt(2 * count)


def opencv_flag(name):
    # OpenCV 5 has moved them out of the module.
    return getattr(cv2.fisheye, name, None) or getattr(cv2, name)


@pytest.mark.slow
def test_same_minimum_as_opencv(world):
    rig = wide(world)
    observed = world.with_noise(world.observe(rig, free=40, placements=0, seed=2), 0)
    # OpenCV divides by z, so it takes only views well in front of it.
    angle = np.hypot(*(observed.corners.q - np.array(rig.centre)).transpose(2, 0, 1)).max(1) / rig.focal[0]
    chosen = np.flatnonzero(angle < np.radians(75))[:24]
    assert len(chosen) == 24
    names = ("q", "sigma", "valid", "angle", "placement", "record")
    corners = replace(observed.corners, **{name: getattr(observed.corners, name)[chosen] for name in names})
    none = jax.tree.map(lambda leaf: leaf[:0], observed.stripes)
    off = dict.fromkeys(PRIORS, np.inf)
    settings = CalibrationSettings(camera="fisheye", free=FLAT, priors=off, reject_any=np.inf)
    calibration = calibrate_camera(replace(observed, corners=corners, stripes=none), settings=settings)
    board = observed.board.corners()[None]
    flags = sum(opencv_flag(f"CALIB_{name}") for name in ("RECOMPUTE_EXTRINSIC", "FIX_SKEW", "USE_INTRINSIC_GUESS"))
    # Without a guess OpenCV stops at views far from the axis.
    guess = np.array([[300.0, 0, 639.5], [0, 300.0, 511.5], [0, 0, 1]]), np.zeros((4, 1))
    rms, k, d, _, _ = cv2.fisheye.calibrate(
        [board] * 24, [q[None] for q in corners.q], rig.size, *guess, flags=flags, criteria=(3, 200, 1e-14)
    )
    camera = calibration.camera
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx, camera.cy], [k[0, 0], k[1, 1], k[0, 2], k[1, 2]], atol=1e-3
    )
    np.testing.assert_allclose(camera.distortion, d.ravel(), atol=1e-5)
    assert calibration.quality.corner_rms_px == pytest.approx(rms, rel=1e-6)
    assert calibration.order == camera.parameter_names()
    sigma = np.sqrt(np.diag(calibration.covariance))
    assert abs(camera.fx - rig.focal[0]) < 4 * sigma[0]
