"""A simulated fisheye against the house's: rays, boards and stripes beside and behind the camera."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import ConfigError
from jaxscan.geometry import DoubleSphere, Fisheye
from jaxscan.simulation import (
    BoardsSpec,
    CameraSpec,
    LaserSpec,
    RoomSpec,
    SeenBoard,
    SimulationConfig,
    TurntableSpec,
    expect_record,
    make_print,
    make_rig,
    make_scene,
    true_scanner,
)
from jaxscan.simulation.rig import Motion, distort, look, project, ray_table, rodrigues
from jaxscan.simulation.sweep import plan_boards


CAMERA = CameraSpec(
    model="fisheye", width=320, height=256, fx=76, fy=76.2, cx=158.2, cy=126.7, k1=-0.02, k2=0.003, k3=-1e-3, k4=1e-4,
    field_deg=190,
)  # fmt: skip
BOARD = BoardsSpec(type="chessboard", columns=7, rows=5, square_mm=60.0, range_m=(0.3, 0.7))


def config(**changes):
    base = {
        "camera": CAMERA,
        # The fan starts behind the camera, so that it lights surfaces beside it.
        "laser": LaserSpec(
            baseline_m=0.25, crossing_m=1.6, waist_mm=2.0, fan_deg=175.0, origin_m=(0.296875, 0.0, -0.3)
        ),
        "turntable": TurntableSpec(direction=(0.0, -1.0, 0.0), point_m=(0.1, 0.0, -0.05)),
        "room": RoomSpec(furniture=False),
        "boards": BOARD,
    }
    return SimulationConfig(**{**base, **changes})


def test_rays_agree_with_the_house():
    scanner = true_scanner(config())
    assert isinstance(scanner.camera, Fisheye)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    q = np.stack([u, v], -1).reshape(-1, 2)
    sees, ways = look(CAMERA, u, v)
    rays, sees = np.stack(ways, -1).reshape(-1, 3), sees.ravel()
    assert 0.5 < sees.mean() < 0.9 and (rays[sees, 2] < -0.08).any()
    # The simulator's table is linear to 1e-11 between its angles.
    unit = np.asarray(jax.jit(jax.vmap(scanner.camera.unproject))(jnp.asarray(q)))
    np.testing.assert_allclose(unit[sees], rays[sees], atol=1e-10)
    np.testing.assert_allclose(np.stack(project(CAMERA, 3.0 * rays[sees]), -1), q[sees], atol=1e-8)
    table, (du, dv) = ray_table(CAMERA), (0.375, -0.25)
    moved = np.stack([part.astype(float) for part in table.at(slice(None), slice(None)).moved(du, dv)], -1)
    exact = np.stack(look(CAMERA, u + du, v + dv)[1], -1)
    inner = (
        look(CAMERA, u + 2, v)[0] & look(CAMERA, u - 2, v)[0] & look(CAMERA, u, v + 2)[0] & look(CAMERA, u, v - 2)[0]
    )
    across = np.cross(moved, exact)[inner]
    # Within a pixel the table is linear: the error is 1e-3 px for this lens of 76 px/rad.
    assert np.linalg.norm(across, axis=-1).max() * CAMERA.fx < 2e-3


def test_rays_of_a_double_sphere_agree_with_the_house():
    camera = CameraSpec(
        model="double_sphere", width=320, height=256, fx=60, fy=60.2, cx=158.2, cy=126.7, xi=-0.18, alpha=0.58
    )
    scanner = true_scanner(config(camera=camera))
    assert isinstance(scanner.camera, DoubleSphere)
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    sees, ways = look(camera, u, v)
    rays, sees = np.stack(ways, -1).reshape(-1, 3), sees.ravel()
    assert 0.5 < sees.mean() < 0.95 and (rays[sees, 2] < -0.08).any()
    # The simulator's table is linear to 1e-11 between its angles, and knows nothing of the closed form.
    unit = np.asarray(jax.jit(jax.vmap(scanner.camera.unproject))(jnp.stack([u.ravel(), v.ravel()], -1)))
    np.testing.assert_allclose(unit[sees], rays[sees], atol=1e-10)
    with pytest.raises(ValueError, match="a double_sphere has no k1"):
        CameraSpec(model="double_sphere", k1=0.1)


def test_lenses_that_cannot_be_are_refused():
    with pytest.raises(ConfigError, match="folds over inside its field of view"):
        ray_table(CAMERA.model_copy(update={"k1": -0.2}))
    with pytest.raises(ValueError, match="a fisheye has no p1 or p2"):
        CameraSpec(model="fisheye", p1=1e-3)
    with pytest.raises(ValueError, match="a pinhole has no k4"):
        CameraSpec(k4=1e-3)
    with pytest.raises(ConfigError, match="no normalised image coordinates"):
        distort(CAMERA, np.zeros(1), np.zeros(1))


@pytest.fixture(scope="module")
def room():
    c = config()
    return expect_record(make_rig(c), make_scene(c), 0.3)


def test_the_stripe_s_truth_is_what_the_house_triangulates(room):
    scanner, found = true_scanner(config()), room.truth
    rows = np.flatnonzero(found.valid)
    assert len(rows) > 200
    q = jnp.asarray(np.column_stack([found.u[rows], rows]))
    p, incidence = jax.jit(jax.vmap(lambda q: scanner.point(q, 0, jnp.asarray(0.3))))(q)
    assert (np.asarray(incidence) > 0).all()
    near = np.linalg.norm(np.asarray(p), axis=-1) < 4
    assert near.sum() > 150
    # Rays are interpolated between pixels: 1e-3 px of 1/76 rad, at up to 1 m per 0.05 rad.
    np.testing.assert_allclose(np.asarray(p)[near], found.xyz[rows][near], atol=2e-3)
    behind = np.asarray(jax.jit(jax.vmap(scanner.camera.unproject))(q))[:, 2] < 0
    assert behind.sum() > 5


def test_the_stripe_is_drawn_where_its_truth_is(room):
    lit = room.truth.valid
    # Not where the fan ends: there half of the stripe is missing.
    rows = np.flatnonzero(lit & np.roll(lit, 3) & np.roll(lit, -3))[::7]
    columns = np.arange(CAMERA.width)
    for row in rows:
        light = room.laser[row].astype(float)
        near = np.abs(columns - room.truth.u[row]) < 6
        centre = (light * columns)[near].sum() / light[near].sum()
        # The rest is the pattern of the floor, of which some is in each tail, and the slope of walls.
        assert centre == pytest.approx(room.truth.u[row], abs=0.04), row


def test_beyond_the_field_of_view_it_is_dark(room):
    dark = ~ray_table(CAMERA).sees
    assert dark[0, 0] and not dark[127, 158]
    assert not room.off[dark].any() and not room.laser[dark].any()
    assert (room.off[~dark] > 0).mean() > 0.99


@pytest.mark.parametrize("angle_deg", [0.0, 60.0, 88.0])
def test_a_board_is_seen_where_projection_puts_it(angle_deg):
    c = config()
    rig, scene = make_rig(c), make_scene(c)
    turn = rodrigues(np.array([0.0, 1.0, 0.0]), np.deg2rad(angle_deg))
    middle = np.append(BOARD.board().outline().mean(0), 0.0)
    pose = Motion(turn, turn @ (np.array([0.01, 0.02, 0.4]) - middle))
    texture = np.full((6 * 20, 8 * 20), 255, np.uint8)
    texture[40:60, 60:80] = 0
    board = SeenBoard(make_print(BOARD, texture), pose.inverse())
    with_square = expect_record(rig, scene, 0.0, board=board).off.astype(float)
    texture[:] = 255
    board = SeenBoard(make_print(BOARD, texture), pose.inverse())
    white = expect_record(rig, scene, 0.0, board=board).off.astype(float)
    missing = np.where(white > 0, 1.0 - with_square / np.where(white > 0, white, 1.0), 0.0)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    seen = np.array([(u * missing).sum(), (v * missing).sum()]) / missing.sum()
    # Column 3 and row 2 of the squares, of which the first begins one square before corner 0.
    low = np.array(BOARD.board().outline()[0]) + 0.06 * np.array([3, 2])
    x, y = (low[i] + 0.06 * (np.arange(20) + 0.5) / 20 for i in range(2))
    patch = np.stack([*np.meshgrid(x, y), np.zeros((20, 20))], -1).reshape(-1, 3)
    centre = np.stack(project(CAMERA, pose.apply(patch)), -1)
    beside = [np.stack(project(CAMERA, pose.apply(patch + step)), -1) - centre for step in 1e-5 * np.eye(3)[:2]]
    # Darkness is counted per pixel, so points of the square weigh by the pixels that they fill.
    area = np.abs(beside[0][:, 0] * beside[1][:, 1] - beside[0][:, 1] * beside[1][:, 0])
    np.testing.assert_allclose(seen, (centre * area[:, None]).sum(0) / area.sum(), atol=0.03)


def test_the_plan_shows_boards_all_around():
    c = config(boards=BOARD.model_copy(update={"free_views": 12, "placements": 2, "angles": 3}))
    rig, scene = make_rig(c), make_scene(c)
    plan = plan_boards(rig, scene, np.random.default_rng(5))
    corners = BOARD.board().corners()
    widest = 0.0
    for placement in plan:
        for phi in placement.angles:
            p = (rig.pose(phi).inverse() @ placement.scanner_from_board).apply(corners)
            u, v = project(CAMERA, p)
            assert 0 < u.min() and u.max() < CAMERA.width - 1 and 0 < v.min() and v.max() < CAMERA.height - 1
            widest = max(widest, np.degrees(np.arctan2(np.hypot(p[:, 0], p[:, 1]), p[:, 2])).max())
    assert 80 < widest < 95
