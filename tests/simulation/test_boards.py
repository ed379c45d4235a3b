"""Rendered boards: corners where projection puts them, the room hidden, the stripe on the print."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import erf

from jaxscan.errors import ConfigError
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
)
from jaxscan.simulation.camera import integrate, psf_weights
from jaxscan.simulation.rig import Motion, distort, rodrigues
from jaxscan.simulation.scene import Material, Mesh, build_scene
from jaxscan.simulation.sweep import plan_boards
from jaxscan.vision import board_texture, find_corners


BOARD = BoardsSpec(type="chessboard", columns=7, rows=5, square_mm=40.0, range_m=(0.6, 1.4))
CAMERA = CameraSpec(width=320, height=256, fx=330, fy=331, cx=158.2, cy=126.7, k1=-0.1, k2=0.03, p1=5e-4)


def picture_of(spec: BoardsSpec, cells: int = 60) -> np.ndarray:
    """A plain chessboard, its first square black."""
    y, x = np.mgrid[: spec.rows + 1, : spec.columns + 1]
    return np.kron(((x + y) % 2 * 255).astype(np.uint8), np.ones((cells, cells), np.uint8))


def config(**changes) -> SimulationConfig:
    base = {
        "camera": CAMERA,
        "laser": LaserSpec(baseline_m=0.25, crossing_m=1.6, waist_mm=1.0),
        "turntable": TurntableSpec(direction=(0.0, -1.0, 0.0), point_m=(0.1, 0.0, -0.05)),
        "room": RoomSpec(furniture=False),
        "boards": BOARD,
    }
    return SimulationConfig(**{**base, **changes})


def pose(x: float, y: float, z: float, *turn: float) -> Motion:
    """T_cam_board with the board's middle at (x, y, z), turned by a rotation vector."""
    vector = np.array(turn)
    angle = float(np.linalg.norm(vector))
    rotation = rodrigues(vector / angle, angle)
    return Motion(rotation, np.array([x, y, z]) - rotation @ np.append(BOARD.board().corners()[:, :2].mean(0), 0))


POSES = [
    pose(0.02, -0.01, 0.55, 0.5, 0.1, 0.05),
    pose(-0.15, 0.08, 0.9, -0.2, 0.6, -0.2),
    pose(0.2, 0.1, 1.1, 0.02, -0.03, 0.01),
    pose(0.0, 0.0, 0.8, 0.001, 0.0, 0.0),
]


def see(c: SimulationConfig, motion: Motion):
    rig, scene = make_rig(c), make_scene(c)
    board = SeenBoard(make_print(c.boards, picture_of(c.boards)), motion.inverse())
    return expect_record(rig, scene, 0.0, board=board)


def corners_of(c: SimulationConfig, motion: Motion) -> np.ndarray:
    points = c.boards.board().corners()
    if c.boards.warp_mm != (0.0, 0.0):
        middle, half = points[:, :2].mean(0), np.ptp(points[:, :2], axis=0) / 2
        x, y = ((points[:, :2] - middle) / half).T
        points[:, 2] = (c.boards.warp_mm[0] * (1 - x**2) + c.boards.warp_mm[1] * (1 - y**2)) / 1000
    p = motion.apply(points)
    return np.stack(distort(c.camera, p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]), -1)


def fit_corner(image: np.ndarray, start: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Place of a chessboard corner: the crossing of two blurred edges, fitted to 9 x 9 pixels.

    (cornerSubPix is biased by 0.02 to 0.03 px however finely the picture is rendered.)
    """
    column, row = np.rint(start).astype(int)
    v, u = np.mgrid[row - 4 : row + 5, column - 4 : column + 5]
    seen = image[v, u].astype(float)

    def misfit(p):
        x, y, first, second, level, contrast, width, slope_u, slope_v = p
        du, dv = u - x, v - y
        edges = [erf((np.cos(a) * dv - np.sin(a) * du) / (np.sqrt(2) * width)) for a in (first, second)]
        return ((level + contrast * edges[0] * edges[1]) * (1 + slope_u * du + slope_v * dv) - seen).ravel()

    angles = np.arctan2(directions[:, 1], directions[:, 0])
    contrast = np.ptp(seen) / 2
    best = [
        least_squares(
            misfit, (*start, *angles, seen.mean(), sign * contrast, 0.8, 0, 0), x_scale=(1, 1, 1, 1, 50, 50, 1, 1, 1)
        )
        for sign in (-1, 1)
    ]
    return min(best, key=lambda solution: solution.cost).x[:2]


@pytest.mark.more
@pytest.mark.parametrize("motion", POSES)
@pytest.mark.parametrize("warp", [(0.0, 0.0), (2.0, -1.5)])
def test_corners_are_where_projection_puts_them(motion, warp):
    c = config(boards=BOARD.model_copy(update={"warp_mm": warp}))
    image = see(c, motion).off
    expected = corners_of(c, motion).reshape(BOARD.rows, BOARD.columns, 2)
    along_u, along_v = np.gradient(expected, axis=1), np.gradient(expected, axis=0)
    found = np.array(
        [
            fit_corner(image, expected[i, j] + (0.2, -0.15), np.stack([along_u[i, j], along_v[i, j]]))
            for i in range(BOARD.rows)
            for j in range(BOARD.columns)
        ]
    )
    error = found - expected.reshape(-1, 2)
    # The model's edges are straight, the picture's bend with lens and board: 0.002 px flat,
    # 0.005 px bowed. A texture shifted by half a cell would show as 0.1 px everywhere.
    assert np.hypot(*error.T).mean() < 0.006
    assert np.abs(error.mean(0)).max() < 0.005


def test_a_printed_edge_does_not_lock_to_the_pixels():
    """An upright edge moved in twentieths of a pixel: the area beside it moves with it."""
    c = config(camera=CAMERA.model_copy(update={"k1": 0.0, "k2": 0.0, "p1": 0.0}))
    rig = make_rig(c)
    scene = build_scene(_far_wall(), np.array([0.0, 0.0, 2.0]), 2.0, shadows=False)
    spec = BOARD
    edge, z = 0.08, 0.8  # an edge between black and white at x = 0.08 m of the board
    measured, expected = [], []
    for shift in np.linspace(0, 1, 11) * z / c.camera.fx:
        motion = Motion(np.eye(3), np.array([-0.1 + shift, -0.07, z]))
        board = SeenBoard(make_print(spec, picture_of(spec)), motion.inverse())
        light = expect_record(rig, scene, 0.0, board=board).off
        u = c.camera.fx * (edge - 0.1 + shift) / z + 158.2
        v = round(c.camera.fy * (0.02 - 0.07) / z + 126.7)
        around = light[v, round(u) - 7 : round(u) + 8].astype(float)
        low, high = around[0], around[-1]
        share = (around - low) / (high - low)
        measured.append(round(u) + 7.5 - share.sum())
        expected.append(u)
    error = np.array(measured) - np.array(expected)
    # The lamp's light grows across the board by 1e-3 per pixel: a constant, not a wave.
    assert np.ptp(error) < 0.004
    assert np.abs(error).max() < 0.05


def _far_wall() -> Mesh:
    mesh = Mesh()
    mesh.quad(
        np.array([3.0, 9.0, -9.0]), np.array([0.0, -18.0, 0.0]), np.array([0.0, 0.0, 18.0]), Material(((0.5,) * 3,))
    )
    return mesh


def test_the_board_hides_the_room_and_carries_the_stripe():
    motion = pose(0.10, 0.05, 0.9, -0.2, 0.6, -0.2)
    c = config()
    record = see(c, motion)
    inside = motion.inverse().apply(make_rig(c).pose(0.0).inverse().apply(record.truth.xyz[record.truth.valid]))
    low, high = BOARD.board().outline()[[0, 2]]
    on_board = np.all((inside[:, :2] > low) & (inside[:, :2] < high), -1)
    assert on_board.sum() > 40
    np.testing.assert_allclose(inside[on_board, 2], 0, atol=3e-6)  # float32 casting
    # Printed black and white both show in the stripe.
    amplitude = record.truth.amplitude[record.truth.valid][on_board]
    assert amplitude.max() / np.percentile(amplitude, 5) > 5
    # The laser's power was set for this view; the stripe falls anywhere between pixels.
    assert amplitude.max() == pytest.approx(BOARD.peak_dn, rel=0.35)


def test_behind_the_board_there_is_no_light():
    """The wall that the camera sees beside the board lies in the board's shadow."""
    c = config()
    rig = make_rig(c)
    scene = build_scene(_far_wall(), np.array([0.0, 0.0, 2.0]), 2.0, shadows=False)
    motion = pose(0.16, 0.0, 0.7, 0.0, 1e-6, 0.0)
    board = SeenBoard(make_print(BOARD, picture_of(BOARD)), motion.inverse())
    record = expect_record(rig, scene, 0.0, board=board)
    free = expect_record(rig, scene, 0.0)
    stripe = np.rint(free.truth.u[126]).astype(int)
    depth, _, _ = board.hit(rig.rays.x[126, stripe - 6 : stripe + 7], rig.rays.y[126, stripe - 6 : stripe + 7])
    assert np.isinf(depth).all(), "the wall's stripe is not behind the board for the camera"
    assert free.laser[126, stripe] > 5
    assert record.laser[126, stripe - 6 : stripe + 7].sum() == 0


def test_a_block_of_samples_is_integrated_as_the_weights_say():
    rng = np.random.default_rng(0)
    weights = psf_weights(0.6, 4)
    radius = len(weights) // 2
    samples = rng.random((4, 4, 2 * radius + 3, 2 * radius + 2), np.float32)
    image = integrate(samples, weights)
    assert image.shape == (3, 2)
    for row in range(3):
        for column in range(2):
            value = 0.0
            for i in range(-radius, radius + 1):
                for j in range(-radius, radius + 1):
                    block = samples[:, :, row + radius + i, column + radius + j]
                    value += weights[radius - j] @ block @ weights[radius - i]
            assert image[row, column] == pytest.approx(value, rel=1e-5)


def test_the_plan_shows_the_board_well_and_repeats():
    c = config(boards=BOARD.model_copy(update={"free_views": 9, "placements": 2, "angles": 3}), room=RoomSpec())
    rig, scene = make_rig(c), make_scene(c)
    plan = plan_boards(rig, scene, np.random.default_rng(5))
    assert [p.number for p in plan] == [None] * 9 + [0, 1]
    corners = c.boards.board().corners()
    tilt, crossed = [], []
    for placement in plan:
        assert len(placement.angles) == (1 if placement.number is None else 3)
        for phi in placement.angles:
            p = (rig.pose(phi).inverse() @ placement.scanner_from_board).apply(corners)
            u, v = distort(c.camera, p[:, 0] / p[:, 2], p[:, 1] / p[:, 2])
            assert p[:, 2].min() > 0
            assert 0 < u.min() and u.max() < c.camera.width - 1 and 0 < v.min() and v.max() < c.camera.height - 1
        at_home = rig.pose(0.0).inverse() @ placement.scanner_from_board
        tilt.append(np.degrees(np.arccos(at_home.rotation[2, 2])))
        beside = at_home.apply(corners) @ rig.sheets[0].normal - rig.sheets[0].distance
        crossed.append(beside.min() < 0 < beside.max())
        distance = at_home.apply(corners)[:, 2].mean()
        assert 0.6 * 0.95 < distance < 1.4 * 1.05
    assert min(tilt) > 19.9 and max(tilt) < 45.1
    assert sum(crossed[:9]) >= 6 and all(crossed[9:])
    assert max(plan[9].angles) - min(plan[9].angles) > 0.1
    again = plan_boards(rig, scene, np.random.default_rng(5))
    assert all(
        np.array_equal(a.scanner_from_board.rotation, b.scanner_from_board.rotation)
        for a, b in zip(plan, again, strict=True)
    )


def test_a_board_that_fits_nowhere_is_refused():
    c = config(boards=BOARD.model_copy(update={"range_m": (0.05, 0.06)}))
    with pytest.raises(ConfigError, match="No pose of the board"):
        plan_boards(make_rig(c), make_scene(c), np.random.default_rng(0))
    with pytest.raises(ConfigError, match="square cells"):
        make_print(BOARD, np.zeros((100, 100), np.uint8))


@pytest.mark.parametrize("kind", ["charuco", "aprilgrid"])
def test_boards_of_markers_are_found_where_they_are_rendered(kind):
    spec = BoardsSpec(
        type=kind,
        columns=6 if kind == "charuco" else 4,
        rows=5 if kind == "charuco" else 3,
        square_mm=60.0,
        marker_mm=46.0,
        dictionary="DICT_4X4_250",
        tag_mm=60.0,
        gap_mm=18.0,
    )
    c = config(boards=spec, camera=CAMERA.model_copy(update={"fx": 330.0, "fy": 330.0}))
    rotation = rodrigues(np.array([0.6, 0.8, 0.0]), 0.3)
    middle = np.append(spec.board().outline().mean(0), 0)
    motion = Motion(rotation, np.array([0.02, -0.01, 0.47]) - rotation @ middle)
    board = SeenBoard(make_print(spec, board_texture(spec.board(), 60)), motion.inverse())
    image = np.rint(expect_record(make_rig(c), make_scene(c), 0.0, board=board).off).astype(np.uint8)
    found = find_corners(image, spec.board())
    assert found is not None and found.valid.mean() > 0.8
    points = motion.apply(spec.board().corners())
    true = np.stack(distort(c.camera, points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]), -1)
    # Levels are rounded to whole DN; corners of markers are found to some hundredths of a pixel.
    error = np.hypot(*(found.q - true)[found.valid].T)
    assert np.median(error) < 0.08 and error.max() < 0.5
