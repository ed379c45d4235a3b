"""Which stripe points count as lying on the board."""

import numpy as np
import pytest

from jaxscan.geometry import Chessboard
from jaxscan.observation import FoundCorners, FoundStripe, select_board_stripe, stack_stripes


@pytest.fixture(scope="module")
def seen(world):
    """Corners of a tilted board, and a line along its middle: u(v), with where it is on the board."""
    rig = world.Rig(lens=(-0.2, 0.05, 0.0, 0.0, 0.0))
    rotation = world.rodrigues(np.array([0.3, -0.25, 0.05]))
    middle = rig.board.corners().mean(0)
    place = np.array([0.02, 0.01, 0.8])
    view = lambda p: world.project(rig, (p - middle) @ rotation.T + place)
    y = np.linspace(-0.1, 0.31, 4000)
    # On a board of 35 mm squares x = 0.1225 m runs through the middles of a column of squares.
    line = view(np.column_stack([np.full_like(y, 0.1225), y, np.zeros_like(y)]))
    rows = np.arange(1024.0)
    inside = (rows > line[0, 1]) & (rows < line[-1, 1])
    u = np.interp(rows, line[:, 1], line[:, 0])
    along = np.interp(rows, line[:, 1], y)
    return rig, view, u, along, inside


def select(seen, *, corners=None, valid=None, board=None, stripe_axis="rows", **options):
    rig, view, u, _, inside = seen
    board = board or rig.board
    corners = view(board.corners()) if corners is None else corners
    valid = np.ones(len(corners), bool) if valid is None else valid
    found = FoundCorners(corners, np.ones(len(corners)), valid)
    stripe = FoundStripe(u, np.full(1024, 0.1), np.full(1024, 1.5), inside, stripe_axis)
    return select_board_stripe(stripe, found, board, **({"points": 1024} | options))


def test_points_on_the_print_and_no_others(seen):
    rig, _, _, along, _ = seen
    stripe = select(seen)
    found = np.zeros(1024, bool)
    found[stripe.q[stripe.valid, 1].astype(int)] = True
    low, high = rig.board.outline()[:, 1].min(), rig.board.outline()[:, 1].max()
    # The margin is a tenth of a square; the map may err by as much again at the very edge.
    assert not found[(along < low + 0.05 * 0.035) | (along > high - 0.05 * 0.035)].any()
    assert found[(along > low + 0.2 * 0.035) & (along < high - 0.2 * 0.035)].all()


def test_sigma_is_across_the_stripe(seen):
    stripe = select(seen)
    q = stripe.q[stripe.valid]
    slope = np.polyfit(q[:, 1], q[:, 0], 1)[0]
    np.testing.assert_allclose(stripe.sigma[stripe.valid], 0.1 * np.cos(np.arctan(slope)), rtol=1e-9)


def test_far_from_any_corner_found_nothing_is_believed(seen):
    rig = seen[0]
    valid = rig.board.corners()[:, 1] < 0.08
    stripe = select(seen, valid=valid)
    full = select(seen)
    assert 0 < stripe.valid.sum() < 0.75 * full.valid.sum()


def test_rows_beside_a_printed_edge_are_put_right_or_dropped(seen):
    u = seen[2]
    image = np.full((1024, 1280), 120, np.uint8)
    rows = np.arange(1024)
    # An edge that crosses the stripe at a shallow angle: dark on its right.
    edge = u + (rows - 600) * 0.05
    image[np.arange(1280)[None] > edge[:, None]] = 30
    stripe = select(seen, off=image)
    found = np.zeros(1024, bool)
    found[stripe.q[stripe.valid, 1].astype(int)] = True
    reference = np.zeros(1024, bool)
    plain = select(seen)
    reference[plain.q[plain.valid, 1].astype(int)] = True
    close = np.abs(edge - u) < 2.0
    far = np.abs(edge - u) > 8.0
    # A stripe of 1.5 px that straddles an edge of 4 : 1 is beyond repair.
    assert reference[close].any() and 0 < found[close].sum() < 0.6 * reference[close].sum()
    np.testing.assert_array_equal(found[far], reference[far])
    row = stripe.q[stripe.valid, 1].astype(int)
    moved = stripe.q[stripe.valid, 0] - u[row]
    # It was drawn to the bright side, the left; the prediction errs by some hundredths of a pixel.
    assert moved.min() > -0.05 and moved[close[row]].max() > 0.1
    assert np.abs(moved[far[row]]).max() < 1e-3
    more = stripe.sigma[stripe.valid] / stripe.sigma.min()
    assert np.median(more[close[row]]) > 1.05 and more[far[row]].max() < 1.001
    # An even image drops nothing, noise of a dark frame included.
    grey = (60 + np.random.default_rng(0).normal(size=image.shape)).round().astype(np.uint8)
    assert select(seen, off=grey).valid.sum() == plain.valid.sum()


def test_columns_are_rows_of_the_transposed_image(seen):
    rig, view = seen[:2]
    image = np.full((1024, 1280), 120, np.uint8)
    image[:, 640:] = 30
    rows = select(seen, off=image)
    columns = select(
        seen, off=np.ascontiguousarray(image.T), corners=view(rig.board.corners())[:, ::-1], stripe_axis="columns"
    )
    np.testing.assert_array_equal(rows.valid, columns.valid)
    np.testing.assert_allclose(rows.q, columns.q[:, ::-1], atol=1e-9)


def test_thinning_and_stacking(seen):
    stripe = select(seen, points=64)
    full = select(seen)
    assert stripe.valid.all() and stripe.q.shape == (64, 2)
    assert stripe.q[0, 1] == full.q[0, 1] and stripe.q[-1, 1] == full.q[full.valid][-1, 1]
    corners = seen[1](seen[0].board.corners())
    found = FoundCorners(corners, np.ones(63), np.ones(63, bool))
    empty = FoundStripe(np.zeros(10), np.ones(10), np.full(10, 1.5), np.zeros(10, bool))
    nothing = select_board_stripe(empty, found, seen[0].board, points=64)
    stack = stack_stripes([(nothing, 0, 0), (stripe, 3, 1)], points=64)
    assert stack.q.shape == (1, 64, 2) and stack.view.tolist() == [3] and stack.laser.tolist() == [1]
    assert stack_stripes([], points=64).q.shape == (0, 64, 2)


def test_a_board_of_few_corners(seen):
    board = Chessboard(3, 3, 0.105)
    view = seen[1]
    stripe = select(seen, corners=view(board.corners()), board=board)
    assert stripe.valid.sum() > 100


def test_points_that_were_not_fitted_through_the_print_have_classes_of_their_own(seen):
    rig, view, u, _, inside = seen
    image = np.full((1024, 1280), 120, np.uint8)
    edge = u + (np.arange(1024) - 600) * 0.05
    image[np.arange(1280)[None] > edge[:, None]] = 30
    by_shift = select(seen, off=image)
    row = by_shift.q[by_shift.valid, 1].astype(int)
    kind = by_shift.contrast[by_shift.valid]
    assert set(kind) == {3, 4, 5}
    assert (kind[np.abs(edge - u)[row] > 8.0] == 3).all() and np.mean(kind[np.abs(edge - u)[row] < 3.0] > 3) > 0.7
    # Without a laser-off image no edge is known.
    alone = select(seen)
    assert (alone.contrast[alone.valid] == 3).all()
    classes = np.arange(1024, dtype=np.int8) % 3
    found = FoundCorners(view(rig.board.corners()), np.ones(63), np.ones(63, bool))
    fitted = FoundStripe(u, np.full(1024, 0.1), np.full(1024, 1.5), inside, "rows", classes)
    through = select_board_stripe(fitted, found, rig.board, points=1024)
    np.testing.assert_array_equal(through.contrast[through.valid], through.q[through.valid, 1].astype(int) % 3)
