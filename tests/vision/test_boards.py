"""Corners in rendered and in real pictures of boards, found anew and where they should be."""

import functools

import cv2
import numpy as np
import pytest

from jaxscan.geometry import DICTIONARIES, Charuco, Chessboard
from jaxscan.observation.prediction import PredictedCorners
from jaxscan.vision import board_texture, boards, find_corners, ink
from jaxscan.vision.corners import edge_directions, refit_corners


CHESS = Chessboard(8, 5, 0.03)
CHARUCO = Charuco(8, 6, 0.03, 0.022)


def seen(board, homography):
    """A picture through a homography (board metres to pixels), which may be drawn on; drawn once for all tests."""
    return drawn(board, tuple(homography.ravel())).copy()


@functools.cache
def drawn(board, homography, size=(800, 600), *, oversampling=8, blur=0.8, noise=1.5, seed=0, light=1.0, steps=1):
    """Averaged over sub-pixels; under so much light, and with several `steps` to a DN in float32."""
    homography = np.reshape(homography, (3, 3))
    per_square = 300
    texture = np.pad(board_texture(board, per_square), per_square, constant_values=255).astype(np.float32)
    x0, y0 = board.outline().min(0) - board.square
    to_texture = np.array(
        [[1 / board.square, 0, -x0 / board.square], [0, 1 / board.square, -y0 / board.square], [0, 0, 1]]
    )
    to_texture = np.diag([per_square, per_square, 1]) @ to_texture
    to_texture[:2] -= 0.5 * to_texture[2]
    # Looked up by hand: warping in OpenCV 4 rounds positions to 1/32 px.
    step = (np.arange(oversampling) + 0.5) / oversampling - 0.5
    u = (np.arange(size[0])[:, None] + step).ravel()
    v = (np.arange(size[1])[:, None] + step).ravel()
    u, v = u.astype(np.float32)[None], v.astype(np.float32)[:, None]
    to_print = (to_texture @ np.linalg.inv(homography)).astype(np.float32)
    x, y, w = (a * u + (b * v + c) for a, b, c in to_print)
    column = np.clip(np.rint(x / w), 0, texture.shape[1] - 1).astype(np.int32)
    row = np.clip(np.rint(y / w), 0, texture.shape[0] - 1).astype(np.int32)
    fine = texture[row, column].reshape(size[1], oversampling, size[0], oversampling).mean((1, 3))
    fine = light * cv2.GaussianBlur(20 + 0.7 * fine, (0, 0), blur)
    fine = fine + noise * np.random.default_rng(seed).normal(size=fine.shape)
    if steps > 1:
        return (np.clip(np.rint(steps * fine), 0, 256 * steps - 1) / steps).astype(np.float32)
    return np.clip(np.rint(fine), 0, 255).astype(np.uint8)


def pose(tilt=0.35, turn=0.1, size=1700.0, shift=(190.0, 190.0)):
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[size * c, -size * s, shift[0]], [size * s, size * c, shift[1]], [tilt, -0.5 * tilt, 1.0]])


def expected(board, homography):
    p = np.column_stack([board.corners()[:, :2], np.ones(len(board.corners()))]) @ homography.T
    return p[:, :2] / p[:, 2:]


@pytest.mark.parametrize("board", [CHESS, CHARUCO])
def test_corners_in_a_rendered_picture(board):
    found = find_corners(seen(board, pose()), board)
    assert found is not None and found.valid.all()
    error = found.q - expected(board, pose())
    # Noise is worth 0.006 px to a fit of all pixels, cornerSubPix errs by 0.02 px and more, unrefined
    # ChArUco corners by 0.29 px. The picture itself is drawn to some thousandths of a pixel.
    size = np.sqrt(np.mean(error**2))
    assert size < 0.012 and np.abs(error).max() < 0.048
    assert 0.7 < np.mean(found.sigma) / size < 1.4


@pytest.fixture(params=["squares", pytest.param("sectors", marks=pytest.mark.more)])
def chess_detector(request, monkeypatch):
    """The first detector of chessboards, and the one that is asked where that finds no even grid."""
    if request.param == "sectors":
        monkeypatch.setattr(boards, "_find_squares", lambda *_: None)


def test_a_board_upside_down_is_known_by_its_black_corner(chess_detector):
    picture = seen(CHESS, pose())
    upright = find_corners(picture, CHESS)
    turned = find_corners(np.ascontiguousarray(picture[::-1, ::-1]), CHESS)
    back = np.array([799.0, 599.0]) - turned.q
    # The same corners with the same numbers, though the picture is upside down.
    assert np.abs(back - upright.q).max() < 0.1


@pytest.mark.more
def test_a_large_image_is_looked_at_in_a_smaller_copy(monkeypatch):
    homography = pose(size=3600.0, shift=(420.0, 420.0))
    picture = drawn(CHESS, tuple(homography.ravel()), (2000, 1500), oversampling=4)
    # Where the copy is not mapped back well, the windows of the fit miss the corners.
    monkeypatch.setattr(boards, "_find_sectors", lambda *_, **__: pytest.fail("not found in the copy"))
    found = find_corners(picture, CHESS)
    assert np.hypot(*(found.q - expected(CHESS, homography)).T).max() < 0.05


def test_an_uneven_grid_is_looked_for_again(monkeypatch):
    homography, first = pose(), cv2.findChessboardCorners
    tried = []

    def one_square_off(*arguments, **keywords):
        found, corners = first(*arguments, **keywords)
        shape, corners = corners.shape, corners.reshape(-1, 2).copy()
        corners[0] += corners[1] - corners[2]
        tried.append(found)
        return found, corners.reshape(shape)

    monkeypatch.setattr(cv2, "findChessboardCorners", one_square_off)
    found = find_corners(seen(CHESS, homography), CHESS)
    assert tried == [True]
    assert np.hypot(*(found.q - expected(CHESS, homography)).T).max() < 0.05


def test_order_of_an_ambiguous_board_is_right_handed_and_points_right(chess_detector):
    board = Chessboard(7, 5, 0.03)
    for turn in (0.0, 0.6, -0.6):
        h = pose(turn=turn, size=1400.0, shift=(300.0, 250.0) if turn else (200.0, 200.0))
        found = find_corners(seen(board, h), board)
        assert np.abs(found.q - expected(board, h)).max() < 0.5


def test_charuco_may_be_partly_hidden():
    picture = seen(CHARUCO, pose())
    picture[:, 420:] = 128
    found = find_corners(picture, CHARUCO)
    truth = expected(CHARUCO, pose())
    assert 6 <= found.valid.sum() < len(found.valid)
    assert not found.valid[truth[:, 0] > 425].any()
    assert np.abs(found.q - truth)[found.valid].max() < 0.4
    assert not found.q[~found.valid].any()


def test_nothing_is_found_where_nothing_is():
    grey = np.random.default_rng(0).integers(90, 110, (300, 400)).astype(np.uint8)
    assert find_corners(grey, CHARUCO) is None
    assert find_corners(grey, CHESS) is None
    picture = seen(CHARUCO, pose())
    picture[:, 300:] = 128
    picture[260:] = 128
    assert find_corners(picture, CHARUCO) is None


MARKED = [(CHESS, 0.02), (CHARUCO, 0.03)]
"""Boards, and light under which they have a contrast of 4 to 5 DN."""


@pytest.mark.more
@pytest.mark.parametrize(("board", "light"), MARKED)
def test_a_dark_board_is_measured_in_all_bits(board, light):
    homography = tuple(pose().ravel())

    def error(steps):
        found = find_corners(drawn(board, homography, noise=0.1, light=light, steps=steps), board)
        if found is None:
            return np.inf, np.inf
        assert found.valid.all()
        wrong = found.q - expected(board, pose())
        return np.sqrt(np.mean(wrong**2)), np.sqrt(np.mean((wrong / found.sigma[:, None]) ** 2))

    (byte, _), (deep, normed) = error(1), error(16)
    # Rounding to whole DN is noise of 0.29 DN, three times that of the sensor here; in 8 bits no marker is read.
    assert np.isinf(byte) == (board is CHARUCO)
    assert deep < 0.6 * byte and deep < 0.03
    # The picture is drawn to some thousandths of a pixel, which no sigma knows.
    assert 0.7 < normed < 1.5


@pytest.mark.parametrize("board", [CHESS, CHARUCO])
def test_the_stretch_for_detectors_does_not_move_corners(board):
    picture = seen(board, pose())
    byte, deep = find_corners(picture, board), find_corners(picture.astype(np.float32), board)
    # Half a per cent of the pixels are clipped at each end of the stretch, paper among them.
    np.testing.assert_allclose(deep.q, byte.q, atol=2e-4)
    np.testing.assert_allclose(deep.sigma, byte.sigma, rtol=1e-2)


def test_a_wrong_picture_is_refused():
    with pytest.raises(ValueError, match="uint8"):
        find_corners(np.zeros((10, 10)), CHESS)
    with pytest.raises(ValueError, match="dictionary"):
        find_corners(np.zeros((100, 100), np.uint8), Charuco(5, 4, 0.03, 0.02, "DICT_NONE"))


def test_the_dictionaries_are_those_of_opencv():
    names = {name for name in dir(cv2.aruco) if name.startswith("DICT_")}
    assert names == set(DICTIONARIES)
    for name, markers in DICTIONARIES.items():
        assert len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList) == markers, name


def test_the_largest_board_is_made_once():
    board = Charuco(68, 68, 0.03, 0.022, "DICT_APRILTAG_36h10")
    picture = np.full((60, 80), 128, np.uint8)
    made = ink.opencv_charuco.cache_info().misses
    for _ in range(3):
        assert find_corners(picture, board) is None
    assert ink.opencv_charuco.cache_info().misses == made + 1


def test_textures_fill_the_outline():
    chess = board_texture(CHESS, 10)
    assert chess.shape == (60, 90) and chess[0, 0] == 0 and chess[0, 10] == 255 and chess[10, 0] == 255
    charuco = board_texture(CHARUCO, 60)
    assert charuco.shape == (360, 480)
    padded = np.pad(charuco, 60, constant_values=255)
    found = find_corners(padded, CHARUCO)
    # Corner (1, 1) of the squares is the common corner of four texture pixels, half a pixel up and left.
    truth = CHARUCO.corners()[:, :2] / 0.03 * 60 - 0.5 + 60
    assert found.valid.all() and np.abs(found.q - truth).max() < 0.05


def look(picture, board, homography, *, off=(0.3, -0.2), reach=1.0, first=None):
    """Expected `off` pixels beside the truth."""
    truth = expected(board, homography)
    columns, rows = board.grid()
    grid = truth.reshape(rows, columns, 2)
    size = np.full(len(truth), min(np.linalg.norm(np.diff(grid, axis=k), axis=-1).min() for k in (0, 1)))
    edges, _ = edge_directions(truth, np.ones(len(truth), bool), board)
    limit = np.array(picture.shape[::-1]) - 1.0
    visible = ((truth >= 0) & (truth <= limit)).all(1)
    predicted = PredictedCorners(truth + off, edges, np.zeros((len(truth), 2)), size, visible)
    return truth, visible, refit_corners(picture, board, predicted, reach=reach, first=first)


@pytest.mark.parametrize("board", [CHESS, CHARUCO])
def test_a_board_that_is_cut_off_is_found_as_far_as_it_is_there(board):
    homography = pose(shift=(540.0, 190.0))
    picture = seen(board, homography)
    # Detection wants a chessboard whole.
    assert board is CHARUCO or find_corners(picture, board) is None
    truth, visible, found = look(picture, board, homography)
    assert 0.5 < visible.mean() < 0.9
    # Of a corner nearer to the border than about half a window too little is seen.
    inner = visible & (truth[:, 0] < 793)
    assert found.valid[inner].all() and not found.valid[~visible].any()
    error = (found.q - truth)[found.valid]
    assert np.sqrt(np.mean(error**2)) < 0.012 and np.abs(error).max() < 0.05
    assert not found.q[~found.valid].any()


def test_what_is_covered_is_not_found_but_the_rest_is():
    picture = seen(CHESS, pose())
    covered = expected(CHESS, pose())[19]
    column, row = np.rint(covered).astype(int)
    picture[row - 15 : row + 16, column - 15 : column + 16] = 90
    truth, _, found = look(picture, CHESS, pose())
    assert not found.valid[19] and found.valid.sum() == len(truth) - 1


def test_what_is_far_from_where_it_should_be_is_not_believed():
    picture = seen(CHESS, pose())
    first = find_corners(picture, CHESS)
    _, _, found = look(picture, CHESS, pose(), off=(2.0, 0.0), reach=1.0, first=first)
    # What was found before stands, for the solve to judge.
    np.testing.assert_array_equal(found.q, first.q)
    assert look(picture, CHESS, pose(), off=(2.0, 0.0), reach=1.0)[2] is None


def test_wrong_corners_are_put_right():
    picture = seen(CHESS, pose())
    first = find_corners(picture, CHESS)
    wrong = first._replace(q=first.q + np.where(np.arange(40) == 7, 3.0, 0.0)[:, None])
    truth, _, found = look(picture, CHESS, pose(), first=wrong)
    assert np.abs(found.q - truth).max() < 0.05


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chess", "charuco"])
@pytest.mark.parametrize("shape", [(1, 1), (4, 6), (12, 200), (200, 12), (15, 15), (16, 16)], ids=str)
def test_an_image_too_small_for_a_board_shows_none(board, shape):
    assert find_corners(np.random.default_rng(0).integers(0, 256, shape, np.uint8), board) is None
