"""The paper's method against OpenCV's projection, exact planes and motions, and rendered frames of known centres."""

import cv2
import numpy as np
import pytest

from experiments.paper import methods
from experiments.paper.figure_6 import Check
from experiments.paper.methods import BoardCorners, PaperWay, gravity, highest
from experiments.paper.stage import smaller, world
from jaxscan.geometry import Chessboard
from jaxscan.simulation import render_sweep
from jaxscan.vision import board_texture


MATRIX = np.array([[2894.462, 0.0, 1016.814], [0.0, 2887.338, 817.261], [0.0, 0.0, 1.0]])
K = -0.1
PLANE = np.array([-7.606, -1.685, 1.296203])
"""Table II; c in metres."""
GRID, SQUARE = (11, 8), 0.04


def motion(turn, shift):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = cv2.Rodrigues(np.array(turn, float))[0], shift
    return out


def project(points, pose=None):
    pose = np.eye(4) if pose is None else pose
    turn = cv2.Rodrigues(pose[:3, :3])[0]
    return cv2.projectPoints(points, turn, pose[:3, 3], MATRIX, np.array([K, 0, 0, 0.0]))[0][:, 0]


@pytest.fixture(scope="module")
def poses():
    random = np.random.default_rng(3)
    out = []
    for _ in range(12):
        pose = motion(random.uniform(-0.5, 0.5, 3), (0, 0, random.uniform(0.9, 1.8)))
        pose[:3, 3] -= pose[:3, :3] @ [0.2, 0.14, 0.0] - [*random.uniform(-0.1, 0.1, 2), 0.0]
        out.append(pose)
    return out


@pytest.fixture(scope="module")
def corners(poses):
    x, y = np.meshgrid(np.arange(GRID[0]), np.arange(GRID[1]))
    places = SQUARE * np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return [BoardCorners(project(places, pose).astype(np.float32), places.astype(np.float32)) for pose in poses]


def points_of_sheet(count=200):
    random = np.random.default_rng(5)
    rays = np.column_stack([random.uniform(-0.2, 0.03, count), random.uniform(-0.25, 0.25, count), np.ones(count)])
    return rays * (PLANE[2] / (rays @ [*PLANE[:2], 1.0]))[:, None]


def test_exact_corners_give_the_exact_camera(corners, poses):
    matrix, k, found = methods.calibrate_camera([None, *corners], (2048, 1638))
    # Corners are rounded to single precision, 1e-4 px.
    np.testing.assert_allclose(matrix, MATRIX, atol=0.02)
    assert k == pytest.approx(K, abs=1e-5)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], poses, atol=1e-5)
    np.testing.assert_allclose(methods.board_pose(MATRIX, K, corners[0]), poses[0], atol=1e-6)


def test_a_calibration_takes_three_boards(corners):
    with pytest.raises(ValueError, match="at least three boards, found 2 in 3 views"):
        methods.calibrate_camera([corners[0], None, corners[1]], (2048, 1638))


def test_rays_and_boards_undo_the_projection(poses):
    random = np.random.default_rng(4)
    places = np.column_stack([random.uniform(0, 0.4, (50, 2)), np.zeros(50)])
    points = places @ poses[0][:3, :3].T + poses[0][:3, 3]
    uv = project(points)
    np.testing.assert_allclose(methods.rays(MATRIX, K, uv), points / points[:, 2:], atol=1e-12)
    np.testing.assert_allclose(methods.points_on_board(MATRIX, K, poses[0], uv), points, atol=1e-12)


def test_an_exact_plane_comes_back():
    points = points_of_sheet()
    np.testing.assert_allclose(methods.linear_plane(points), PLANE, rtol=1e-10)
    np.testing.assert_allclose(methods.total_plane(points), PLANE, rtol=1e-10)


def test_noise_along_z_moves_only_the_total_fit():
    """Equation (8) minimises the errors along Z, so noise there alone leaves it without bias."""
    points = points_of_sheet(20000)
    points[:, 2] += 0.1 * np.random.default_rng(6).standard_normal(len(points))
    linear, total = (fit(points)[0] / PLANE[0] - 1 for fit in (methods.linear_plane, methods.total_plane))
    assert 4 * abs(linear) < abs(total)


def test_tr_is_the_motion_between_two_views():
    board, turned = motion((0.2, -0.3, 0.1), (0.1, -0.1, 1.3)), motion((0, 0.0345, 0), (-0.0073, 0, 0.0002))
    tr = methods.pair_motion(board, np.linalg.inv(turned) @ board)
    np.testing.assert_allclose(tr, turned, atol=1e-14)


def test_powers_turn_by_multiples_of_the_angle():
    axis = np.array([0.02, -0.999, 0.01]) / np.linalg.norm([0.02, -0.999, 0.01])
    angle = np.deg2rad(1.98)
    tr = motion(angle * axis, (-0.00734, 0.0000031, 0.00021142))
    numbers = np.array([0, 1, 2, 7, 0.5, -1, 360 / 1.98, 1800])
    found = methods.power(tr, numbers)
    for n, each in zip(numbers, found, strict=True):
        np.testing.assert_allclose(each[:3, :3], cv2.Rodrigues(n * angle * axis)[0], atol=1e-9)
        if n == int(n):
            np.testing.assert_allclose(each, np.linalg.matrix_power(tr, int(n)), atol=1e-9)
    np.testing.assert_allclose(found[4] @ found[4], tr, atol=1e-14)
    shifts = methods.power(motion((0, 0, 0), (0.0, 0.1, 0.2)), np.array([0.5, 3.0]))[:, :3, 3]
    np.testing.assert_allclose(shifts, [[0, 0.05, 0.1], [0, 0.3, 0.6]], atol=1e-15)


def test_a_fixed_point_stays_in_the_cloud():
    """A sweep sees one point of the room from three table angles at the sheet: all come to one place."""
    tr, pair = motion((0, -0.03, 0), (0.006, 0, 0.0001)), 0.03
    way = PaperWay(MATRIX, K, np.zeros((0, 4, 4)), [], PLANE, PLANE, tr, pair)
    fixed, angles = points_of_sheet(1)[0], np.array([0.0, 0.015, 0.06])
    seen = methods.points_on_sheet(way, project(points_of_sheet()))
    np.testing.assert_allclose(seen, points_of_sheet(), atol=1e-11)
    # The camera moves with the table, so in its own frame the point has moved back; a sheet of its own meets it there.
    for angle, moved in zip(angles, methods.power(tr, angles / pair), strict=True):
        there = np.linalg.inv(moved) @ np.append(fixed, 1.0)
        own = way._replace(linear=np.array([*PLANE[:2], PLANE[:2] @ there[:2] + there[2]]))
        uv = project(there[None, :3])[0]
        rows = np.zeros((1, round(uv[1]) + 2))
        rows[0, round(uv[1])] = uv[0]
        cloud = methods.paper_cloud(own, rows, rows > 0, np.array([angle]))
        assert np.isfinite(cloud[0]).all(1).sum() == 1
        # Its row is a whole one: half a pixel off at the most.
        assert np.linalg.norm(cloud[0, round(uv[1])] - fixed) < 0.01 * np.linalg.norm(fixed)


def test_a_ray_that_misses_the_sheet_gives_no_point():
    way = PaperWay(MATRIX, K, np.zeros((0, 4, 4)), [], PLANE, PLANE, np.eye(4), 0.1)
    assert np.isnan(methods.points_on_sheet(way, np.array([[1900.0, 800.0]]))).all()


def test_a_board_is_found_in_one_order_however_it_is_turned():
    board = Chessboard(columns=GRID[0], rows=GRID[1], square=SQUARE)
    image = np.full((500, 600), 255, np.uint8)
    image[70 : 70 + 9 * 36, 80 : 80 + 12 * 36] = board_texture(board, 36)
    image = cv2.GaussianBlur(image, None, 1.0)
    found = methods.find_board(image, board.grid(), board.square)
    turned = methods.find_board(np.ascontiguousarray(image[::-1, ::-1]), board.grid(), board.square)
    # The middle of the pixels' edge between the squares.
    true = np.array([80, 70]) - 0.5 + 36 * (1 + found.places[:, :2] / SQUARE)
    back = np.array([599, 499]) - turned.pixels
    assert min(np.abs(found.pixels - each).max() for each in (true, true[::-1])) < 0.05
    np.testing.assert_allclose(back, found.pixels, atol=0.05)
    assert methods.find_board(np.full((300, 400), 90, np.uint8), board.grid(), board.square) is None


def test_strays_on_a_board_are_left_out(poses):
    outline = np.array([[-SQUARE, -SQUARE], [0.44, -SQUARE], [0.44, 0.32], [-SQUARE, 0.32]])
    middle = project((poses[0] @ [0.2, 0.14, 0, 1])[None, :3])[0]
    u, valid = np.zeros(1638), np.zeros(1638, bool)
    rows = np.arange(round(middle[1]) - 100, round(middle[1]) + 100)
    u[rows], valid[rows] = middle[0] + 0.2 * (rows - middle[1]), True
    u[rows[17]] += 25
    u[5], valid[5] = 3, True
    kept = methods.stripe_on_board(MATRIX, K, poses[0], outline, (u, valid))
    assert sorted(kept[:, 1]) == [row for row in rows if row != rows[17]]


def test_points_are_compared_at_the_rows_of_another_method():
    one = Check(3, np.array([5, 6, 8]), np.arange(9.0).reshape(3, 3), np.ones(3))
    others = [
        Check(2, np.array([6]), np.zeros((1, 3)), np.ones(1)),
        Check(3, np.array([8, 5]), one.difference, one.row),
    ]
    np.testing.assert_array_equal(one.at_rows_of(others).row, [5, 8])
    assert len(one.at_rows_of(others[:1]).row) == 0


def drawn(centres, columns=80, width=1.5):
    at = np.arange(columns)
    light = 120 * np.exp(-((at - np.asarray(centres)[..., None]) ** 2) / (2 * width**2))
    off = np.full(light.shape, 60, np.uint8)
    return np.rint(off + light).astype(np.uint8), off


def test_plain_centres_of_drawn_lines():
    centres = np.linspace(20, 50, 91)
    on, off = drawn(centres)
    u, valid = gravity(on, off)
    assert valid.all()
    # Pixels below the threshold are cut off, more on one side than on the other.
    assert np.abs(u - centres).max() < 0.15 and abs((u - centres).mean()) < 0.01
    u, valid = highest(on, off)
    assert valid.all() and np.abs(u - centres).max() <= 0.51 and (u == np.rint(u)).all()


def test_plain_centres_of_stacks_edges_and_empty_rows():
    on, off = drawn([[0.3, 79.0], [30.2, -40.0]])
    for extract in (gravity, highest):
        u, valid = extract(on, off)
        np.testing.assert_array_equal(valid, [[True, True], [True, False]])
        assert u[1, 1] == 0 and abs(u[0, 1] - 79) < 1.5 and abs(u[0, 0]) < 1.5
        single = extract(on[1], off[1])
        np.testing.assert_array_equal(single[0], u[1])
        with pytest.raises(ValueError, match="of one shape"):
            extract(on, off[:1])


@pytest.mark.parametrize(("name", "sharp", "whole"), [("kind", 0.20, 0.36), ("unkind", 0.30, 0.60)])
def test_plain_centres_of_rendered_frames(name, sharp, whole):
    """Bounds: a whole pixel has 0.29 px at best, and the threshold costs a narrow line 0.1 px as in the test before;
    speckle and blur of the unkind world add to both.
    """
    config = smaller(world(name), 0.125)
    records = list(render_sweep(config, angles=np.deg2rad([0.0, 20.0, 45.0])))
    on, off = (np.stack([getattr(record, side) for record in records]) for side in ("on", "off"))
    true, known = (np.stack([getattr(record.truth, part) for record in records]) for part in ("u", "valid"))
    for extract, bound in ((gravity, sharp), (highest, whole)):
        u, valid = extract(on, off)
        both = valid & known
        assert both.sum() > 0.6 * known.sum()
        error = (u - true)[both]
        # Corners and edges of furniture move a few centres by pixels.
        assert np.sqrt(np.mean(error[np.abs(error) < 3] ** 2)) < bound
        assert np.mean(np.abs(error) < 3) > 0.97
