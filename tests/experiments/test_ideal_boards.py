"""Ideal observations of boards against the geometry, which knows nothing of how they were made."""

from pathlib import Path

import jax
import numpy as np
import pytest

import jaxscan
from experiments.exact_rig import PosePlan, add_noise, draw_poses, ideal_boards
from jaxscan.geometry import invert, transform
from jaxscan.simulation import SimulationConfig, true_scanner


CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def load(name: str, **boards) -> SimulationConfig:
    config = jaxscan.load_simulation(CONFIGS / f"{name}.toml")
    return config.model_copy(update={"boards": config.boards.model_copy(update=boards)})


def crooked() -> SimulationConfig:
    """The reference rig with everything bent that can be."""
    config = load("reference", warp_mm=(0.8, -0.5))
    laser = config.laser[0].model_copy(update={"bow": (2e-3, -1e-3)})
    table = config.turntable.model_copy(update={"gain": -1.002, "harmonics": (1e-3, -2e-3, 5e-4, 7e-4)})
    camera = config.camera.model_copy(update={"p1": 4e-4, "p2": -3e-4, "k3": 0.02})
    return config.model_copy(update={"laser": (laser,), "turntable": table, "camera": camera})


@pytest.fixture(scope="module", params=["reference", "crooked", "desk"])
def world(request):
    config = crooked() if request.param == "crooked" else load(request.param)
    poses = draw_poses(config, 3, PosePlan(free_views=3, placements=2, angles=3, span_deg=10.0))
    return config, poses, ideal_boards(config, poses, points=60)


def board_poses(config, poses):
    """T_cam_board of every view by the geometry's own turntable."""
    table = true_scanner(config).turntable
    back = jax.jit(jax.vmap(lambda phi: invert(table.motion(phi))))(poses.angle)
    still = np.array([np.eye(4) for _ in poses.boards])
    still[:, :3, :3] = [board.rotation for board in poses.boards]
    still[:, :3, 3] = [board.translation for board in poses.boards]
    return np.asarray(back) @ still[poses.placement]


def height(config, xy):
    corners = config.boards.board().corners()[:, :2]
    a, b = ((xy - (corners.min(0) + corners.max(0)) / 2) / (np.ptp(corners, axis=0) / 2)).T
    return np.array(config.boards.warp_mm) / 1000 @ np.stack([1 - a * a, 1 - b * b])


def test_corners_are_where_the_geometry_sees_them(world):
    config, poses, ideal = world
    camera = true_scanner(config).camera
    corners = config.boards.board().corners()
    corners[:, 2] = height(config, corners[:, :2])
    seen = jax.jit(jax.vmap(jax.vmap(lambda T, p: camera.project(transform(T, p)), (None, 0)), (0, None)))
    # Two forward models in float64 differ by the rounding of some thousand pixels.
    np.testing.assert_allclose(seen(board_poses(config, poses), corners), ideal.corner_q, atol=1e-9)
    assert (ideal.corner_q > 0).all()
    assert (ideal.corner_q < np.array([config.camera.width, config.camera.height]) - 1).all()


def test_stripe_points_lie_on_sheet_and_board(world):
    config, poses, ideal = world
    scanner = true_scanner(config)
    # Free views cross the stripe by half of the board at least.
    assert set(range(3)) <= set(ideal.stripe_view)
    T = board_poses(config, poses)[ideal.stripe_view]
    lift = jax.jit(
        jax.vmap(
            jax.vmap(lambda q: scanner.camera.unproject(q) * scanner.laser(0).intersect(scanner.camera.unproject(q))[0])
        )
    )
    p = np.asarray(lift(ideal.stripe_q))
    on_board = np.einsum("sji,spj->spi", T[:, :3, :3], p - T[:, None, :3, 3])[ideal.stripe_valid]
    np.testing.assert_allclose(on_board[:, 2], height(config, on_board[:, :2]), atol=1e-9)
    low, high = config.boards.board().outline()[[0, 2]]
    assert (on_board[:, :2] > low - 1e-9).all() and (on_board[:, :2] < high + 1e-9).all()
    rows = ideal.stripe_q[ideal.stripe_valid][:, 1]
    np.testing.assert_array_equal(rows, np.round(rows))
    assert ideal.stripe_valid.sum(1).max() <= 60


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_noise_is_as_stated(correlation):
    config = load("reference")
    ideal = ideal_boards(config, draw_poses(config, 0, PosePlan(free_views=40, placements=0)), points=100)
    noisy = add_noise(ideal, np.random.default_rng(0), correlation=correlation)
    # 7040 corner coordinates: 0.8 % of a standard deviation, times four.
    assert (noisy.corner_q - ideal.corner_q).std() == pytest.approx(0.1, rel=0.035)
    full = ideal.stripe_valid.all(1)
    assert full.sum() > 20
    shift = (noisy.stripe_q - ideal.stripe_q)[full]
    assert not shift[..., 1].any()
    tangent = np.gradient(ideal.stripe_q[full], axis=1)
    across = shift[..., 0] * tangent[..., 1] / np.linalg.norm(tangent, axis=-1)
    # More than 2000 points, worth a quarter of them where correlated: 3 %, times four.
    assert across.std() == pytest.approx(0.15, rel=0.13)
    neighbours = np.mean(across[:, 1:] * across[:, :-1]) / np.mean(across**2)
    assert neighbours == pytest.approx(correlation, abs=0.12)
