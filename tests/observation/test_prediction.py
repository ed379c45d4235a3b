"""Where a board and the stripe on it will be seen, against a forward model written apart."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate, choose, estimate, solved_rig
from jaxscan.calibration.advice import warn_of_missing_lines
from jaxscan.observation import FoundCorners, Look, SeenRecord
from jaxscan.observation.prediction import lift_to_board, predict_corners, predict_stripe, turn_boards
from jaxscan.stripes import LaserLine


@pytest.fixture(scope="module")
def estimated(world):
    rig = world.Rig(lens=(-0.2, 0.05, 4e-4, -3e-4, 0.0), warp=(4e-4, -3e-4), gain=1.0005)
    observed = world.observe(rig)
    return rig, observed, estimate(observed, settings=CalibrationSettings())


@pytest.fixture(scope="module")
def solved(estimated):
    rig, observed, found = estimated
    return rig, observed, solved_rig(found)


def test_corners_are_where_they_were_seen(solved):
    _, observed, predicting = solved
    predicted = predict_corners(predicting, predicting.poses)
    # Perfect observations, so the fit is one.
    np.testing.assert_allclose(predicted.q, observed.corners.q, atol=1e-5)
    assert predicted.visible.all()
    columns, rows = observed.board.grid()
    grid = predicted.q.reshape(-1, rows, columns, 2)
    step = grid[:, 1:-1, 2:] - grid[:, 1:-1, :-2]
    along = predicted.edges.reshape(-1, rows, columns, 2, 2)[:, 1:-1, 1:-1, 0]
    # The chord of two squares and the tangent in its middle differ by perspective alone.
    cosine = (step * along).sum(-1) / np.linalg.norm(step, axis=-1)
    assert cosine.min() > 1 - 1e-4
    np.testing.assert_array_less(
        predicted.size.reshape(-1, rows, columns)[:, 1:-1, 1:-1], 0.51 * np.linalg.norm(step, axis=-1) * 1.02
    )


def test_corners_beside_and_behind_the_image_are_not_visible(solved):
    predicting = solved[2]
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, :3, 3] = [(0.3, 0.0, 0.8), (0.0, 0.0, -0.8), (3.0, 0.0, 0.5)]
    visible = predict_corners(predicting, pose).visible
    assert 0 < visible[0].sum() < visible.shape[1]
    assert not visible[1].any() and not visible[2].any()


def test_a_corner_in_the_centre_of_the_camera_is_not_visible(solved):
    predicting = solved[2]
    pose = np.eye(4)
    pose[:3, 3] = -np.asarray(predicting.surface().point(predicting.board.corners()[:1, :2]))[0]
    assert not predict_corners(predicting, pose[None]).visible[0, 0]


def test_a_board_seen_from_one_angle_is_known_from_all(solved):
    _, observed, predicting = solved
    angle, placement = np.asarray(observed.corners.angle), np.asarray(observed.corners.placement)
    together = np.flatnonzero(placement == placement[-1])
    assert len(together) == 5
    seen = np.full(5, together[0])
    poses = turn_boards(predicting.scanner.turntable, predicting.poses[seen], angle[seen], angle[together])
    np.testing.assert_allclose(poses, predicting.poses[together], atol=1e-9)


def test_the_stripe_runs_where_it_was_seen(solved):
    _, observed, predicting = solved
    checked = 0
    for row, view in enumerate(observed.stripes.view):
        q = observed.stripes.q[row][observed.stripes.valid[row]]
        stripe = predict_stripe(predicting, predicting.poses[view], 0)
        inside = (q[:, 1] > 1) & (q[:, 1] < observed.height - 2)
        below = np.floor(q[inside, 1]).astype(int)
        both = stripe.on_board[below] & stripe.on_board[below + 1]
        share = q[inside, 1] - below
        u = stripe.u[below] * (1 - share) + stripe.u[below + 1] * share
        # Straight between 128 points of the curve: 1e-3 px where lens and board bend it most.
        np.testing.assert_allclose(u[both], q[inside, 0][both], atol=5e-3)
        checked += both.sum()
    # All but the ends of the stripes, whose last whole row lies beyond the board.
    assert checked > 0.9 * observed.stripes.valid.sum()


def test_columns_are_rows_turned(solved):
    _, observed, predicting = solved
    view = int(observed.stripes.view[0])
    rows = predict_stripe(predicting, predicting.poses[view], 0)
    columns = predict_stripe(predicting, predicting.poses[view], 0, "columns")
    at = np.flatnonzero(columns.on_board)
    back = np.interp(columns.u[at], np.flatnonzero(rows.on_board), rows.u[rows.on_board])
    assert len(at) > 3
    # The stripe is steep: an error along it counts as many times more across.
    np.testing.assert_allclose(back[1:-1], at[1:-1], atol=0.05)


def test_points_of_the_image_on_the_board(solved):
    _, observed, predicting = solved
    for view in (0, len(observed.corners.angle) - 1):
        xy = lift_to_board(predicting, predicting.poses[view], observed.corners.q[view])
        np.testing.assert_allclose(xy, observed.board.corners()[:, :2], atol=1e-7)


def test_a_camera_alone_predicts_no_stripe(solved):
    with pytest.raises(ValueError, match="no stripe"):
        predict_stripe(solved[2]._replace(scanner=None), np.eye(4), 0)


def test_a_solve_that_did_not_converge_predicts_nothing(solved):
    assert solved_rig(estimate(solved[1], settings=CalibrationSettings(max_steps=1, only="camera"))) is None


def test_a_second_estimate_begins_from_the_camera_of_the_first_and_ends_where_it_did(estimated, monkeypatch):
    _, observed, found = estimated
    monkeypatch.setattr(calibrate, "seed_camera", lambda *_: pytest.fail("a camera is there"))
    again = estimate(observed, settings=CalibrationSettings(), before=found)
    np.testing.assert_allclose(again.camera.parameters(), found.camera.parameters(), rtol=1e-9, atol=1e-9)


def test_a_second_estimate_is_kept_unless_it_explains_less(estimated):
    first = estimated[2]
    second = replace(first, seconds=first.seconds + 1.0)
    kept, look = choose(first, second)
    assert kept is second and look.kept and look.corners_gained == 0
    astray = replace(first, adjustment=replace(first.adjustment, converged=False))
    without_motion = replace(first, rig=replace(first.rig, moves=False))
    without_sheet = replace(first, rig=replace(first.rig, lasers=()))
    for worse in (astray, without_motion, without_sheet):
        kept, look = choose(first, worse)
        assert kept is first and not look.kept


def test_boards_that_show_no_line_though_the_sheet_meets_them_are_named(solved):
    """Of boards that it does not meet, or that no laser lit, nothing is missed."""
    _, observed, rig = solved
    corners, lit = observed.corners, set(observed.stripes.view.tolist())
    lost, dark = sorted(lit)[:2], sorted(lit)[2]
    views = []
    for view in range(len(corners.q)):
        record = SimpleNamespace(i=100 + view, lasers=() if view == dark else (0,), on=("on",))
        found = () if view in lost or view == dark or view not in lit else (object(),)
        seen = FoundCorners(corners.q[view], corners.sigma[view], corners.valid[view])
        views.append(SeenRecord(0, record, corners=seen, stripes=found))
    look = Look(observed.board, views, ((LaserLine(name=observed.laser_names[0]),),), {})
    missed, met = look.without_a_line(rig)
    assert missed == [100 + view for view in lost] and met == len(lit) - 1
    (warning,) = warn_of_missing_lines(missed, met)
    assert (
        warning.startswith(f"no line was found on 2 of {met} boards") and f"records {missed[0]}, {missed[1]}" in warning
    )
    assert look._replace(lines=None).without_a_line(rig) == ([], 0) and warn_of_missing_lines([], met) == ()
