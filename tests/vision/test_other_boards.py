"""Grids of circles and AprilGrids: found where they are, and good for a calibration."""

import functools

import cv2
import numpy as np
import pytest

from jaxscan.geometry import AprilGrid, Circles
from jaxscan.vision import board_texture, find_corners
from jaxscan.vision.april_grid import find_april_grid

from .printed import CAMERA, LENS, SIZE, inside, picture, pose, seen_at


pytestmark = pytest.mark.more


CIRCLES = Circles(4, 11, 0.02, 0.018)
SYMMETRIC = Circles(7, 6, 0.03, 0.018, "symmetric")
APRIL = AprilGrid(5, 4, 0.0105, 0.035)
PER_SQUARE = {CIRCLES: 80, SYMMETRIC: 100, APRIL: 60}
BOARDS = pytest.mark.parametrize("board", [CIRCLES, SYMMETRIC, APRIL], ids=["circles", "symmetric", "aprilgrid"])
WIDTH = {board: float(np.ptp(board.outline()[:, 0])) for board in (CIRCLES, SYMMETRIC, APRIL)}


@functools.cache
def texture(board):
    return board_texture(board, PER_SQUARE[board])


def poses(board):
    """Twelve poses: near and far, tilted by up to 40 degrees to all sides."""
    made = []
    for k in range(12):
        tilt, side = (0.0, 25.0, 40.0)[k % 3], 30.0 * k
        for depth in (1.35, 1.6, 1.9, 2.3):
            far = depth * max(WIDTH[board], np.ptp(board.outline()[:, 1])) * (1.25 if k % 2 else 1.0)
            motion = pose(
                tilt, side, (-15.0, 3.0, 12.0, 5.0)[k % 4], far, board, (0.05 * np.cos(side), 0.04 * (k % 3 - 1))
            )
            if inside(board, motion):
                made.append(motion)
                break
    return made


@functools.cache
def views(board):
    """Found and true corners of every pose."""
    motions = poses(board)
    pictures = [picture(board, texture(board), PER_SQUARE[board], motion, seed) for seed, motion in enumerate(motions)]
    return [
        (find_corners(image, board), seen_at(board, motion)) for image, motion in zip(pictures, motions, strict=True)
    ]


def test_white_circles_on_black_are_found_like_black_ones_on_white():
    image = picture(CIRCLES, texture(CIRCLES), PER_SQUARE[CIRCLES], poses(CIRCLES)[1], 1)
    found, (white, _) = find_corners(255 - image, CIRCLES), views(CIRCLES)[1]
    assert np.abs(found.q - white.q).max() < 0.02


@pytest.mark.more
@BOARDS
def test_corners_are_where_they_are(board):
    found = views(board)
    assert len(found) >= 10
    for corners, truth in found:
        # Of an AprilGrid some tags may be missed.
        assert corners is not None and corners.valid.sum() >= (0.75 if board is APRIL else 1.0) * len(truth)
        error = (corners.q - truth)[corners.valid]
        # A centre that is not corrected for perspective is off by up to 0.4 px in these pictures, a corner of OpenCV's
        # markers by 0.5 px.
        assert np.sqrt(np.mean(error**2)) < 0.05
        assert np.abs(error).max() < 0.25


@pytest.mark.more
@BOARDS
def test_sigmas_are_honest(board):
    errors = np.concatenate([(found.q - truth)[found.valid] for found, truth in views(board)])
    sigmas = np.concatenate([found.sigma[found.valid] for found, _ in views(board)])
    ratio = np.sqrt(np.mean((errors / sigmas[:, None]) ** 2))
    # Those of fits are that of noise, and edges drawn to a quarter of a pixel add as much again.
    assert 0.25 < ratio < 2.5


@BOARDS
def test_a_calibration_finds_the_camera(board):
    seen = [
        (board.corners()[found.valid].astype(np.float32), found.q[found.valid].astype(np.float32)[:, None])
        for found, _ in views(board)
    ]
    rms, camera, lens, *_ = cv2.calibrateCamera(*zip(*seen, strict=True), SIZE, None, None)
    assert rms < 0.06
    # Twelve views with 0.02 px of noise fix the focal length to some 0.3 px, the centre to 0.5 px.
    assert np.abs(camera - CAMERA)[[0, 1], [0, 1]].max() < 1.5
    assert np.abs(camera - CAMERA)[:2, 2].max() < 1.5
    assert abs(lens.ravel()[0] - LENS[0]) < 0.02


def test_centres_are_corrected_for_perspective():
    """The plain centre of weight of a large tilted circle is off by tenths of a pixel."""
    motion = pose(40.0, 0.0, 80.0, 0.3, CIRCLES)
    truth = seen_at(CIRCLES, motion)
    shown = (truth > 15).all(1) & (truth < np.array(SIZE) - 16).all(1)
    assert shown.all()
    image = picture(CIRCLES, texture(CIRCLES), PER_SQUARE[CIRCLES], motion)
    found = find_corners(image, CIRCLES)
    plain = Circles(4, 11, 0.02, 0.018)
    blobs = cv2.SimpleBlobDetector.Params()
    blobs.minArea, blobs.maxArea, blobs.minDistBetweenBlobs = 12, 20000, 3
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    _, rough = cv2.findCirclesGrid(image, plain.grid(), flags=flags, blobDetector=cv2.SimpleBlobDetector.create(blobs))
    rough = np.asarray(rough).reshape(-1, 2)
    nearest = np.linalg.norm(rough[:, None] - truth[None], axis=-1).min(1)
    assert np.sqrt(np.mean(nearest**2)) > 0.15
    assert np.sqrt(np.mean((found.q - truth) ** 2)) < 0.04


@pytest.mark.parametrize("roll", [0.0, 80.0, 180.0, -100.0])
def test_an_asymmetric_grid_knows_its_turn(roll):
    motion = pose(20.0, 45.0, roll, 0.45, CIRCLES)
    found = find_corners(picture(CIRCLES, texture(CIRCLES), PER_SQUARE[CIRCLES], motion), CIRCLES)
    assert np.abs(found.q - seen_at(CIRCLES, motion)).max() < 0.25


@pytest.mark.parametrize("border", [1, 2])
@pytest.mark.parametrize("downwards", [False, True])
@pytest.mark.parametrize("squares", [True, False])
def test_april_grids_of_other_printers(border, downwards, squares):
    """Borders of one cell, numbers from the top, and no small squares between the tags."""
    drawn = texture(APRIL).copy()
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    gap, side = PER_SQUARE[APRIL], round(APRIL.tag / APRIL.square * PER_SQUARE[APRIL])
    if not squares:
        drawn[:] = 255
    for row in range(APRIL.rows):
        for column in range(APRIL.columns):
            number = (row if downwards else APRIL.rows - 1 - row) * APRIL.columns + column
            # Programs differ in the turn of the tag too.
            tag = np.rot90(cv2.aruco.generateImageMarker(dictionary, number, side, borderBits=border), 2 * downwards)
            top, left = gap + row * (side + gap), gap + column * (side + gap)
            drawn[top : top + side, left : left + side] = tag
    motion = pose(25.0, 60.0, 8.0, 0.42, APRIL)
    found = find_corners(picture(APRIL, drawn, gap, motion), APRIL)
    error = (found.q - seen_at(APRIL, motion))[found.valid]
    assert found.valid.sum() >= 0.6 * len(found.valid)
    # Without small squares a corner has ink on one side alone, whose blur pulls it; its sigma says so.
    assert np.sqrt(np.mean(error**2)) < (0.05 if squares else 0.25)
    assert np.mean(np.abs(error) < 2.5 * found.sigma[found.valid][:, None]) > 0.9


def test_a_part_of_an_april_grid_suffices():
    motion = pose(20.0, 10.0, 0.0, 0.4, APRIL)
    image = picture(APRIL, texture(APRIL), PER_SQUARE[APRIL], motion)
    image[:, 380:] = 128
    found = find_corners(image, APRIL)
    truth = seen_at(APRIL, motion)
    assert 16 <= found.valid.sum() < len(truth)
    assert not found.valid[truth[:, 0] > 390].any()
    assert np.abs(found.q - truth)[found.valid].max() < 0.3


@BOARDS
def test_nothing_is_found_where_nothing_is(board):
    rng = np.random.default_rng(3)
    assert find_corners(rng.integers(90, 110, (300, 400)).astype(np.uint8), board) is None
    assert find_corners(np.full((20, 20), 128, np.uint8), board) is None


def test_tags_of_one_row_are_refused():
    """Whether numbers run upwards or downwards shows in a second row only."""
    motion = pose(0.0, 0.0, 0.0, 0.4, APRIL)
    image = picture(APRIL, texture(APRIL), PER_SQUARE[APRIL], motion)
    truth = seen_at(APRIL, motion).reshape(2 * APRIL.rows, 2 * APRIL.columns, 2)
    image[int(truth[1, :, 1].max()) + 12 :] = 128
    assert find_april_grid(image, image, APRIL) is None
