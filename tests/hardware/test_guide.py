"""The guide's advice for known poses: corners and stripes are projected, nothing is detected."""

from pathlib import Path

import numpy as np
import pytest
from scanrig.checks import guide
from scanrig.checks.guide import Guide, guess_focal, pose_of, view_board

from jaxscan.calibration import advice as after
from jaxscan.geometry import Charuco, Chessboard


SIZE = (1280, 1024)
FOCAL = 1400.0
BOARD = Chessboard(columns=9, rows=6, square=0.04)
LIT = np.full(SIZE[::-1], 90, np.uint8)


def turned(tilt_deg=0.0, towards_deg=0.0, roll_deg=0.0):
    """Rotation of a board that is turned in its plane, then tilted towards a side of the image."""
    tilt, towards, roll = np.radians([tilt_deg, towards_deg, roll_deg])
    axis = np.array([-np.sin(towards), np.cos(towards), 0.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    tilting = np.eye(3) + np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross
    rolling = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    return tilting @ rolling


def corners(rotation, middle=(0.0, 0.0), depth=1.0, board=BOARD, focal=FOCAL):
    """Corners of a board whose middle is seen `middle` px beside that of the image, at a depth [m]."""
    points = board.corners() - board.outline().mean(0)[[0, 1, 0]] * [1, 1, 0]
    points = points @ rotation.T + [middle[0] * depth / focal, middle[1] * depth / focal, depth]
    q = focal * points[:, :2] / points[:, 2:] + (np.array(SIZE) - 1) / 2
    return q, ((q > 0) & (q < np.array(SIZE) - 1)).all(1)


def column(u):
    """An upright line of the laser."""
    return np.column_stack([np.full(SIZE[1], float(u)), np.arange(SIZE[1])])


class Poses:
    """A camera that shows given corners and stripes."""

    def __init__(self, *, laser=True):
        self.now, self.line = None, column(-100.0)
        self.guide = Guide(BOARD, SIZE, lambda off: self.now, {"red": lambda on, off: self.line} if laser else {})

    def take(self, *args, line=None, placement=None, **how):
        self.now = corners(turned(*args), **how)
        q, valid = self.now
        self.line = column(q[valid, 0].mean() if line is None else line)
        look = self.guide.look(LIT, LIT)
        self.guide.keep(look, placement)
        return look


@pytest.fixture
def poses():
    return Poses()


def test_the_limits_and_the_words_are_those_of_the_advice_afterwards():
    assert guide.coverage is after.coverage
    for source in (Path(guide.__file__).read_text(), Path(after.__file__).read_text()):
        for name in ("PARTS", "TILT", "STRIPES", "DEPTHS", "PLACEMENTS"):
            assert f"coverage.ASK_FOR_{name}.format(" in source
        for name in ("MIN_TILT_DEG", "MIN_DEPTH_RATIO", "MIN_STRIPES", "MIN_PLACEMENTS", "count_cells", "empty_parts"):
            assert f"coverage.{name}" in source


@pytest.mark.parametrize("tilt", [0.0, 15.0, 30.0, 50.0])
@pytest.mark.parametrize("towards", [0.0, 70.0, 200.0])
def test_poses_come_out_as_they_were(tilt, towards):
    q, valid = corners(turned(tilt, towards, 20.0), middle=(150, -80), depth=1.3)
    view = view_board(BOARD, q, valid, None, SIZE)
    pose = pose_of(view, FOCAL)
    # The corners are exact, so all that is left is arithmetic.
    assert pose.tilt_deg == pytest.approx(tilt, abs=1e-4)
    assert pose.depth_m == pytest.approx(corner_depth(tilt, towards), rel=1e-6)
    # Without its true focal length a tilt is still distinguished from none.
    rough = pose_of(view, SIZE[0])
    assert abs(rough.tilt_deg - tilt) < 8.0


def corner_depth(tilt, towards):
    """Depth of the board's origin, corner 0."""
    origin = -np.append(BOARD.outline().mean(0), 0.0)
    return (turned(tilt, towards, 20.0) @ origin)[2] + 1.3


@pytest.mark.parametrize("focal", [800.0, 1400.0, 3000.0])
def test_the_focal_length_follows_from_tilted_boards(focal):
    rng = np.random.default_rng(0)
    views = []
    for k in range(6):
        q, valid = corners(turned(35.0, 60.0 * k, 10.0 * k), depth=focal / 1400, focal=focal)
        views.append(view_board(BOARD, q + 0.1 * rng.normal(size=q.shape), valid, None, SIZE))
    # Tenths of a pixel on boards of 450 px; distances then are right to the same.
    assert guess_focal(views, SIZE) == pytest.approx(focal, rel=0.1)


def test_flat_boards_give_no_focal_length():
    q, valid = corners(turned())
    assert guess_focal([view_board(BOARD, q, valid, None, SIZE)] * 5, SIZE) == SIZE[0]
    assert guess_focal([], SIZE) == SIZE[0]


def test_the_laser_on_the_board(poses):
    assert poses.take(20.0).view.where == "across the middle of the board"
    q, _ = poses.now
    look = poses.take(20.0, line=q[:, 0].max() - 10)
    assert look.view.crossed and look.view.where == "across the right of the board"
    assert poses.take(20.0, line=q[:, 0].min() + 10).view.where == "across the left of the board"
    # Beyond the outermost squares, which are one square wider than the corners.
    square = 0.04 * FOCAL
    look = poses.take(20.0, line=q[:, 0].max() + 1.5 * square)
    assert not look.view.crossed and "does not cross the board" in look.notes[0]
    assert look.view.stripe_lines == 0
    assert poses.guide.coverage().crossed == 3


def test_without_laser_nothing_is_said_of_it():
    poses = Poses(laser=False)
    assert "laser" not in poses.guide.advice()[0]
    look = poses.take(20.0)
    assert look.notes == ()
    for tilt in (0.0, 30.0, 40.0):
        poses.take(tilt)
        assert not any("stripe" in line for line in poses.guide.advice(most=9))


def test_first_the_board_is_asked_for(poses):
    (sentence,) = poses.guide.advice()
    assert sentence == "hold the board still, wholly in the picture, with the laser's line across it"


def test_the_stripe_comes_first_where_it_is_missing(poses):
    for x in (-300, 0, 300):
        poses.take(30.0, 45.0 * x, middle=(x, 0), line=-50)
    assert poses.guide.advice()[0] == "capture the stripe on more boards: it was seen on 0 of 3"


def test_tilts_are_asked_for(poses):
    for x in (-400, 0, 400):
        for y in (-300, 0, 300):
            poses.take(middle=(x, y), depth=1.0 + 0.3 * (x > 0))
    assert any(line.startswith("tilt the board by 20 to 45 degrees: hardly one") for line in poses.guide.advice(most=9))
    assert "tilt" in poses.guide.advice(most=1)[0]


def test_the_empty_part_of_the_image_is_named(poses):
    for k, depth in enumerate((0.8, 1.0, 1.4, 2.0)):
        poses.take(30.0, 90.0 * k, 25.0 * k, middle=(250, 180), depth=depth)
    empty = poses.guide.coverage().empty_cells
    assert "upper left" in empty and "lower right" not in empty
    assert any(line.startswith("bring the board into the upper left") for line in poses.guide.advice())


def test_distances_are_asked_for(poses):
    for k in range(8):
        poses.take(30.0, 90.0 * k, 15.0 * k, middle=(-420 + 120 * k, (-1) ** k * 250), depth=1.0)
    asked = poses.guide.advice(most=9)
    assert any("nearer and farther" in line for line in asked)
    near, far = poses.guide.coverage().depth_m
    assert far < 1.5 * near


def test_in_the_end_nothing_is_missing(poses):
    for k in range(24):
        x, y = 440 * np.cos(k), 330 * np.sin(1.7 * k)
        poses.take(20.0 + k % 4 * 8.0, 90.0 * k, 30.0 * (k % 3), middle=(x, y), depth=0.6 + 0.08 * (k % 12))
    assert poses.guide.advice(most=9) == []
    seen = poses.guide.coverage()
    assert (seen.views, seen.crossed, seen.tilt_sides) == (24, 24, 4)
    assert seen.tilted >= 20 and seen.depth_m[1] > 1.9 * seen.depth_m[0]


def test_placements(poses):
    first, second = poses.guide.advice("placement")
    assert first.startswith("stand the board where it will not move") and second.endswith("there is 0")
    for number in range(3):
        poses.take(20.0, placement=number)
        poses.take(20.0, middle=(100, 0), placement=number)
    assert poses.guide.coverage().placements == 3
    (again,) = poses.guide.advice("placement")
    assert again.startswith("stand it elsewhere than before")


@pytest.mark.parametrize(
    "frame, why",
    [
        (np.full(SIZE[::-1], 8, np.uint8), "the picture is dark"),
        (np.full(SIZE[::-1], 255, np.uint8), "too bright"),
        (LIT, "must be in the picture"),
    ],
)
def test_a_pose_without_board_is_refused(poses, frame, why):
    look = poses.guide.look(frame, frame)
    assert look.view is None and why in look.problem
    poses.guide.keep(look)
    assert poses.guide.coverage().views == 0
    assert poses.guide.pose(look) is None


def test_corners_on_one_line_are_no_board(poses):
    q, valid = corners(turned())
    poses.now = (q, valid & (np.arange(len(q)) < 9))
    assert poses.guide.look(LIT, LIT).view is None


def test_part_of_a_charuco_board_is_enough():
    board = Charuco(columns=12, rows=9, square=0.03, marker=0.022)
    q, valid = corners(turned(25.0), middle=(600, 0), depth=0.5, board=board)
    assert 6 < valid.sum() < len(valid)
    view = view_board(board, np.where(valid[:, None], q, 0.0), valid, None, SIZE)
    assert pose_of(view, FOCAL).tilt_deg == pytest.approx(25.0, abs=1e-4)
