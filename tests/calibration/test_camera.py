"""The camera alone: against OpenCV's solver, and on real pictures."""

import functools
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_camera
from jaxscan.calibration.settings import PRIORS
from jaxscan.files.calibration import load_calibration, save_calibration
from jaxscan.geometry import Chessboard, fit_axis, fit_plane, plane_sigma
from jaxscan.observation import BoardViews, Observations, StripeViews
from jaxscan.vision import find_corners


DATA = Path(__file__).parents[1] / "data"
QUICK = CalibrationSettings(judge=False)
FLAT = tuple(block for block in CalibrationSettings().free if block != "warp")


def observations(board, found, size):
    count = len(found)
    return Observations(
        board=board,
        corners=BoardViews(
            q=np.array([f.q for f in found]),
            sigma=np.array([f.sigma for f in found]),
            valid=np.array([f.valid for f in found]),
            angle=np.zeros(count),
            placement=np.zeros(count, np.int32),
            record=np.arange(count, dtype=np.int32),
        ),
        stripes=StripeViews(
            np.zeros((0, 64, 2)),
            np.zeros((0, 64)),
            np.zeros((0, 64), bool),
            np.zeros(0, np.int32),
            np.zeros(0, np.int32),
        ),
        width=size[0],
        height=size[1],
        laser_names=("laser",),
    )


CICLOP, CHESS = Chessboard(6, 11, 0.013), Chessboard(9, 6, 0.025)


@functools.cache
def pictures(pattern, board, half=None):
    """Corners of real pictures, found once for all tests; with `half`, by OpenCV in windows of that half side."""
    paths = sorted(DATA.glob(pattern))
    if not paths:
        pytest.skip(f"real data {pattern} are not here")
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
    found = [find_corners(image, board) for image in images]
    if half is not None:
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
        start = [one.q.astype(np.float32).reshape(-1, 1, 2) for one in found]
        moved = [cv2.cornerSubPix(*both, (half, half), (-1, -1), stop) for both in zip(images, start, strict=True)]
        found = [one._replace(q=q.reshape(-1, 2).astype(float)) for one, q in zip(found, moved, strict=True)]
    return observations(board, found, images[0].shape[::-1])


def test_same_minimum_as_opencv(world):
    # OpenCV takes single precision: squares of 1/32 m and corners that are exact in it are the same for both.
    rig = world.Rig(board=Chessboard(9, 7, 1 / 32))
    observed = world.with_noise(world.observe(rig, free=12, placements=0), 0)
    single = observed.corners.q.astype(np.float32).astype(np.float64)
    observed = replace(observed, corners=replace(observed.corners, q=single))
    off = dict.fromkeys(PRIORS, np.inf)
    settings = CalibrationSettings(free=FLAT, priors=off, reject_any=np.inf, judge=False)
    calibration = calibrate_camera(observed, settings=settings)
    points = observed.board.corners().astype(np.float32)
    rms, k, d, _, _ = cv2.calibrateCamera(
        [points] * 12,
        [q.astype(np.float32) for q in observed.corners.q],
        rig.size,
        None,
        None,
        criteria=(3, 200, 1e-14),
    )
    camera = calibration.camera
    # OpenCV stops where the cost no longer changes in its digits: about 1e-4 px of focal length.
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx, camera.cy], [k[0, 0], k[1, 1], k[0, 2], k[1, 2]], atol=1e-3
    )
    np.testing.assert_allclose(camera.distortion, d.ravel(), atol=1e-5)
    assert calibration.quality.corner_rms_px == pytest.approx(rms, rel=1e-4)
    assert calibration.scanner is None
    assert calibration.order == camera.parameter_names()
    assert calibration.covariance.shape == (9, 9)


def test_covariance_of_the_camera_is_opencvs(world):
    rig = world.Rig()
    observed = world.with_noise(world.observe(rig, free=12, placements=0), 1)
    off = dict.fromkeys(PRIORS, np.inf)
    calibration = calibrate_camera(
        observed, settings=CalibrationSettings(free=FLAT, priors=off, reject_any=np.inf, judge=False)
    )
    points = observed.board.corners().astype(np.float32)
    extended = cv2.calibrateCameraExtended(
        [points] * 12, [q.astype(np.float32) for q in observed.corners.q], rig.size, None, None
    )
    theirs = np.asarray(extended[5]).ravel()[:9]
    # The same J'J and the same variance of unit weight; both of float32 corners.
    np.testing.assert_allclose(np.sqrt(np.diag(calibration.covariance)), theirs, rtol=0.02)


# The references take the boards for true, so their shape is held; freed, f is 3 px less.
TRUE = CalibrationSettings(judge=False, free=tuple(block for block in QUICK.free if block != "shape"))


def test_ciclop():
    observed = pictures("ciclop/camera/*.jpg", CICLOP)
    reference = json.loads((DATA / "ciclop/reference.json").read_text())["measured"]["intrinsics"]
    calibration = calibrate_camera(observed, settings=TRUE)
    camera = calibration.camera
    assert calibration.quality.converged and len(calibration.quality.per_view) == 16
    found = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    # The reference is a plain solve by OpenCV. Ours weighs pictures by their promises: two standard deviations.
    sigma = np.sqrt(np.diag(calibration.covariance)[:4])
    assert (sigma < 0.75).all() and (np.abs(found - reference["K_portrait"]) < 2.0 * sigma).all(), sigma
    # With cornerSubPix it is 0.245 px over all corners, outliers too.
    assert calibration.quality.corner_rms_px <= calibration.quality.corner_rms_all_px < 0.235


@pytest.mark.parametrize(("side", "most"), [("left", 0.155), pytest.param("right", 0.150, marks=pytest.mark.more)])
def test_opencv_chessboards(side, most):
    calibration = calibrate_camera(pictures(f"opencv_stereo_chess/{side}*.jpg", CHESS), settings=TRUE)
    # cornerSubPix: 0.170 and 0.174 px over all corners.
    assert calibration.quality.corner_rms_px <= calibration.quality.corner_rms_all_px < most
    if side == "left":
        assert 531 <= float(calibration.camera.fx) <= 537
        assert 531 <= float(calibration.camera.fy) <= 537
    # The same board in both cameras: bowed by -0.17 mm along its short side, to 0.02 mm.
    assert calibration.quality.board_warp_m[1] == pytest.approx(-1.7e-4, abs=4e-5)


def test_a_window_that_reaches_the_next_corner_is_told_by_its_view():
    """Half a window of 11 px is more than left02's smallest squares leave."""
    quality = calibrate_camera(pictures("opencv_stereo_chess/left*.jpg", CHESS, 11), settings=TRUE).quality
    rms = np.array([view.corner_rms_px for view in quality.per_view])
    # left02 is the second picture, and it alone is named.
    assert int(np.argmax(rms)) == 1 and rms[1] > 1.0 and rms[1] > 5 * np.median(rms)
    assert [k for k in range(len(rms)) if any(f"record {k}" in warning for warning in quality.warnings)] == [1]


@pytest.mark.more
def test_a_rational_lens_of_few_views_can_be_written(tmp_path):
    # k1 to k6 are nearly one direction here (condition 1e8): inverted without care, the covariance lost its symmetry.
    observed = pictures("opencv_stereo_chess/right*.jpg", CHESS)
    settings = CalibrationSettings(free=(*CalibrationSettings().free, "rational"), judge=False)
    calibration = calibrate_camera(observed, settings=settings)
    np.testing.assert_array_equal(calibration.covariance, calibration.covariance.T)
    save_calibration(calibration, tmp_path / "camera.json")
    read = load_calibration(tmp_path / "camera.json")
    np.testing.assert_allclose(read.covariance, calibration.covariance, rtol=1e-12)


@pytest.fixture(scope="module")
def laser_points():
    path = DATA / "ciclop/laser-pc.ply"
    if not path.exists():
        pytest.skip("real data ciclop/laser-pc.ply are not here")
    raw = path.read_bytes()
    body = raw[raw.index(b"end_header") + 11 :]
    return np.frombuffer(body[: 15 * 5975], np.dtype([("p", "<f4", 3), ("c", "u1", 3)]))["p"].astype(float)


def test_ciclop_laser_plane(laser_points):
    reference = json.loads((DATA / "ciclop/reference.json").read_text())["measured"]["laser_plane_svd"]
    plane = fit_plane(laser_points)
    # The reference is printed with 8 and 4 decimals.
    np.testing.assert_allclose(plane.normal, reference["n"], atol=1e-6)
    assert plane.distance == pytest.approx(reference["distance_mm"], abs=1e-3)
    assert plane.rms == pytest.approx(reference["std_mm"], abs=1e-5)


def test_a_plane_from_a_shallow_target_does_not_claim_to_know_three_metres(laser_points):
    points = laser_points
    # The points reach over 29 mm of depth, mostly along the optical axis; two published fits of them
    # differ by 0.19 degrees: 1.1 of the standard deviations at 3 m.
    sigma = plane_sigma(points, np.array([0.0, 0.0, 3000.0]))
    reach = np.linalg.norm(np.array([0.0, 0.0, 3000.0]) - points.mean(0))
    assert 0.19 / 2 < np.degrees(sigma / reach) < 2 * 0.19
    # As if all 5975 points erred by themselves, it would be 25 times less, and wrong.
    shuffled = np.random.default_rng(0).permutation(points)
    assert plane_sigma(shuffled, np.array([0.0, 0.0, 3000.0])) < sigma / 15


def test_plane_sigma_is_that_of_repeated_fits():
    random = np.random.default_rng(1)
    flat = np.column_stack([random.uniform(-3, 3, 400), random.uniform(-1, 1, 400), np.full(400, 5.0)])
    at = np.array([4.0, 6.0, 5.0])
    heights, predicted = [], []
    for _ in range(400):
        points = flat + np.array([0.0, 0.0, 1.0]) * 0.02 * random.normal(size=(400, 1))
        plane = fit_plane(points)
        heights.append((plane.distance - plane.normal @ at) / plane.normal[2])
        predicted.append(plane_sigma(points, at))
    # 400 draws know a standard deviation to 3.5 %: three of these, and a chance correlation of white noise.
    assert np.std(heights) / np.median(predicted) == pytest.approx(1.0, abs=0.12)


def test_ciclop_axis():
    path = DATA / "ciclop/turntable_pattern_origins_mm.json"
    if not path.exists():
        pytest.skip("real data ciclop/turntable_pattern_origins_mm.json are not here")
    points = np.array(json.loads(path.read_text()))
    reference = json.loads((DATA / "ciclop/reference.json").read_text())["measured"]["turntable"]
    axis = fit_axis(points)
    sense = np.sign(axis.direction @ np.array(reference["n"]))
    np.testing.assert_allclose(sense * axis.direction, reference["n"], atol=1e-4)
    centre = np.array(reference["circle_centre_mm"])
    along = axis.point + (centre @ axis.direction) * axis.direction
    # 5 um, and half a digit of the printed direction over the 0.3 m from the foot to the circle.
    np.testing.assert_allclose(along, centre, atol=5e-3)
    radius = np.linalg.norm(np.cross(points - axis.point, axis.direction), axis=1)
    assert radius.mean() == pytest.approx(reference["circle_radius_mm"], abs=5e-3)
