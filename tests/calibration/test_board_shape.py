"""Boards that are no parabola: modes, held-out views, the shape that is chosen, and what it does to the rig."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.calibration.board_shape import bent_modes, smooth_modes
from jaxscan.files.calibration import load_calibration, save_calibration
from jaxscan.geometry import Chessboard, corner_frame
from jaxscan.observation import Observations
from jaxscan.report import calibration_page


pytestmark = pytest.mark.more


QUICK = CalibrationSettings(judge=False)
PARABOLA = CalibrationSettings(judge=False, free=tuple(block for block in QUICK.free if block != "shape"))


def twist(a, b):
    return 3e-4 * a * b


def seen(world, rig, **plan) -> Observations:
    return world.with_noise(world.observe(rig, seed=3, **plan), 3)


@pytest.mark.parametrize("size", [(9, 7), (3, 3), (4, 11)])
def test_modes_hold_no_motion_no_scale_and_no_bow(size):
    board = Chessboard(*size, 0.03).corners()
    frame = corner_frame(board)
    smooth = smooth_modes(board, frame, len(board) + 5)
    every = smooth.corner[: len(board)]
    x, y = (board[:, :2] - board[:, :2].mean(0)).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    given = [(zero, zero, part) for part in (one, x, y, x**2, y**2)]
    given += [(one, zero, zero), (zero, one, zero), (-y, x, zero), (x, y, zero)]
    given = np.array([np.stack(part, -1).ravel() / np.linalg.norm(part) for part in given])
    columns = every.reshape(3 * len(board), -1)
    columns = columns[:, np.any(columns != 0, axis=0)]
    columns = columns / np.linalg.norm(columns, axis=0)
    np.testing.assert_allclose(given @ columns, 0.0, atol=1e-9)
    np.testing.assert_allclose(columns.T @ columns, np.eye(columns.shape[1]), atol=1e-9)
    assert not smooth.corner[len(board) :].any()
    assert not bent_modes(smooth).corner[:, :2].any()


@pytest.mark.more
def test_a_twisted_board_is_found_out_and_a_flat_one_left_alone(world, tmp_path):
    plan = {"free": 16, "placements": 4, "angles": 5}
    flat = seen(world, world.Rig(), **plan)
    once, again = (calibrate_observations(flat, settings=settings) for settings in (PARABOLA, QUICK))
    assert again.quality.board.free == "parabola"
    np.testing.assert_array_equal(again.scanner.lasers.normal, once.scanner.lasers.normal)
    rig = world.Rig(bend=twist)
    observed = seen(world, rig, **plan)
    found = calibrate_observations(observed, settings=QUICK)
    board = found.quality.board
    assert board.free == "bent"
    assert board.held_out_rms_px < 0.97 * board.held_out_rms_parabola_px
    # As the detector promises: root 2 of 0.1 px, to what 36 views know.
    assert board.held_out_rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.03)
    x, y = (observed.board.corners()[:, :2] - observed.board.corners()[:, :2].mean(0)).T
    true = twist(x / x.max(), y / y.max())
    error = (np.array(board.height_m) - true) / np.array(board.height_sigma_m)
    assert np.sqrt(np.mean(error**2)) < 2.0
    assert np.abs(np.array(board.height_m) - true).max() < 6e-5
    normal = np.abs(world.errors(found.scanner, rig)) / np.sqrt(np.maximum(np.diag(found.covariance), 1e-30))
    for name in ("fx", "laser.laser.n1", "laser.laser.n2", "laser.laser.d", "axis.d1", "axis.d2"):
        assert normal[found.order.index(name)] < 3.0, name
    save_calibration(found, tmp_path / "rig.json")
    assert load_calibration(tmp_path / "rig.json").quality.board == board
    assert "Shape of the board" in calibration_page(found)


def printed_wrong(xy):
    """Lines of the print that bend by 0.2 mm."""
    a, b = ((xy - xy.mean(0)) / np.ptp(xy, axis=0) * 2).T
    return 2e-4 * np.stack([a * b * b, a * a * b], -1)


def test_a_print_out_of_place_is_found_by_a_camera_alone(world):
    observed = seen(world, world.Rig(print_error=printed_wrong), free=16, placements=0)
    calibration = calibrate_camera(observed, settings=QUICK)
    board = calibration.quality.board
    assert board.free == "smooth"
    assert board.held_out_rms_px < 0.97 * board.held_out_rms_parabola_px
    assert np.abs(np.array(board.shift_m)).max() > 5e-5
    assert calibration.quality.corner_noise_over_sigma == pytest.approx(1.0, abs=0.06)


def test_too_few_views_leave_a_parabola(world):
    observed = seen(world, replace(world.Rig(), bend=twist), free=7, placements=0)
    board = calibrate_camera(observed, settings=QUICK).quality.board
    assert board.free == "parabola" and board.held_out_rms_px is None
