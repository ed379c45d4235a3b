"""The same kind of world from jaxscan's own simulator with `configs/unkind.toml`, and its truth.

    python -m experiments.unkind.simulated SEED FOLDER

The seed changes room, laser and board poses too, not the noise alone.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter  # type: ignore[import-untyped]
from scipy.special import j1  # type: ignore[import-untyped]

import jaxscan
from experiments.unkind import truth
from experiments.unkind.scene import look
from experiments.unkind.truth import render_seed
from jaxscan.simulation import (
    ExpectedRecord,
    Motion,
    SeenBoard,
    SimulationConfig,
    TrueRig,
    develop,
    expect_record,
    make_print,
    make_rig,
    make_scene,
    plan_boards,
    sweep_angles,
    true_scanner,
)
from jaxscan.simulation import truth as simulation_truth
from jaxscan.vision import board_texture


CONFIG = Path(__file__).resolve().parents[2] / "configs" / "unkind.toml"
TEXTURE_PX = 60
PANELS = np.zeros((0, 2), int)
BEND = 2e-3
"""Second difference of the inverse depth, as a part of it, that counts as an edge: 0 on planes."""


def draw_config(seed: int) -> SimulationConfig:
    """The unkind configuration with a room, a laser and a wall brightness of this seed."""
    rng = np.random.default_rng([seed, 41])
    config = jaxscan.load_simulation(CONFIG)
    assert config.room is not None
    size = [*rng.uniform(4.0, 4.3, 2), 2.5]
    place = [size[0] / 2 + rng.uniform(-0.1, 0.1), size[1] / 2 + rng.uniform(-0.1, 0.1), rng.uniform(1.1, 1.25)]
    laser = config.laser[0].model_copy(update={"peak_dn": float(rng.uniform(60, 160))})
    room = config.room.model_copy(
        update={
            "size_m": tuple(map(float, size)),
            "rig_m": tuple(map(float, place)),
            "yaw_deg": float(rng.uniform(0, 360)),
        }
    )
    changed = config.model_copy(update={"seed": seed, "room": room, "laser": (laser,)})
    return SimulationConfig.model_validate(changed.model_dump())


def pixel_contrast(config: SimulationConfig) -> float:
    """Standard deviation over mean of the laser's light on a whole pixel, by the aperture's autocovariance."""
    spec, sensor = config.laser[0], config.sensor
    grain = spec.grain_px(sensor)
    x = np.linspace(-1, 1, 401)
    r = np.hypot(*np.meshgrid(x, x)) * np.pi / grain
    shape = np.where(r < 1e-9, 1.0, (2 * j1(r) / np.maximum(r, 1e-9)) ** 2)
    weight = (1 - np.abs(x)) / (1 - np.abs(x)).sum()
    return float(spec.speckle_contrast * np.sqrt(weight @ shape @ weight))


class Rows:
    """The truth of records, row by row."""

    def __init__(self, rig: TrueRig, scene: Any) -> None:
        """Of a rig in its room."""
        self.rig, self.scene, camera = rig, scene, rig.config.camera
        self.lens = np.array([camera.fx, camera.fy, *camera.centre(), *list(camera.coefficients().values())[:4]])

    def depth(self, phi: float, board: SeenBoard | None) -> np.ndarray:
        """Depth at pixel centres [rows, columns]."""
        pose, rays = self.rig.pose(phi), self.rig.rays
        far = self.scene.cast(pose.translation, pose.turn(rays.vectors))[0].reshape(rays.shape)
        return far if board is None else np.minimum(far, board.hit(rays.x, rays.y, rays.z)[0])

    def edges(self, phi: float, depth: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Whether a jump, a crease, a shadow or a border is within 4 px and 2 rows of centres [rows]."""
        near = 1 / depth.astype(np.float64)
        bent = np.zeros(depth.shape, bool)
        bent[:, 1:-1] |= np.abs(np.diff(near, 2, axis=1)) > BEND * near[:, 1:-1]
        bent[1:-1] |= np.abs(np.diff(near, 2, axis=0)) > BEND * near[1:-1]
        bent |= ~np.isfinite(depth)
        rows = np.arange(len(at))
        column = np.rint(at).astype(int)
        columns = np.clip(column[:, None] + np.arange(-4, 5), 0, depth.shape[1] - 1)
        rays, pose = self.rig.rays.vectors.reshape(*depth.shape, 3), self.rig.pose(phi)
        points = pose.apply((rays[rows[:, None], columns] * depth[rows[:, None], columns, None]).reshape(-1, 3))
        origin = pose.apply(self.rig.sheets[0].origin)
        # A little in front of the surface, so that it does not hide itself.
        points = points + 2e-3 * (origin - points)
        shadow = np.zeros(depth.shape, bool)
        shadow[rows[:, None], columns] = self.scene.blocked(origin, points.astype(np.float32)).reshape(columns.shape)
        edge = maximum_filter(bent | shadow, (5, 9), mode="nearest")
        border = (column < 4) | (column >= depth.shape[1] - 4) | (rows < 2) | (rows >= len(at) - 2)
        return edge[rows, np.clip(column, 0, depth.shape[1] - 1)] | border

    def contrast(self, board: SeenBoard, u: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """(max - min) / (max + min) of the print within 4 px along the row behind the lens; NaN beside the board."""
        steps = np.arange(-6.0, 6.01, 0.25)
        rows = np.repeat(np.arange(len(u)), len(steps)).astype(float)
        way = look(self.lens, (u[:, None] + steps).ravel(), rows)
        far, bx, by = (part.reshape(len(u), -1) for part in board.hit(way[:, 0], way[:, 1]))
        level = np.where(np.isfinite(far), board.albedo(bx, by), np.nan)
        middle = np.isfinite(level[:, len(steps) // 2])
        # Something in front of the board hides it.
        seen = depth[np.arange(len(u)), np.clip(np.rint(u).astype(int), 0, depth.shape[1] - 1)]
        middle &= far[:, len(steps) // 2] < seen + 0.02
        out = np.full(len(u), np.nan)
        level = level[middle]
        level = np.where(np.isfinite(level), level, np.nanmax(level, axis=1, keepdims=True)) if len(level) else level
        level = gaussian_filter1d(level, self.rig.config.sensor.psf_px / 0.25, axis=1, mode="nearest")[:, 8:-8]
        high, low = level.max(1, initial=0.0), level.min(1, initial=1e9)
        out[middle] = (high - low) / (high + low)
        return out

    def stripes(self, record: ExpectedRecord, board: SeenBoard | None) -> truth.TrueStripes:
        """The truth of one record [rows, crossings]; the simulator names the brightest crossing alone."""
        given, depth = record.truth, self.depth(record.angle, board)
        u = np.where(given.valid, given.u, 0.0)
        rows, column = np.arange(len(u)), np.rint(u).astype(int)
        at = np.clip(column[:, None] + np.arange(-4, 5), 0, depth.shape[1] - 1)
        light = record.laser[rows[:, None], at].astype(np.float64)
        total = np.maximum(light.sum(1), 1e-9)
        mean = (light * at).sum(1) / total
        width = np.sqrt(np.maximum((light * (at - mean[:, None]) ** 2).sum(1) / total - 1 / 12, 0.25))
        out = truth.TrueStripes(*(grid[0] for grid in truth.empty(1, len(u))))
        peak = np.where(given.valid, total / (np.sqrt(2 * np.pi) * width), 0.0)
        beside = record.off[rows, np.clip(column, 0, depth.shape[1] - 1)]
        contrast = np.full(len(u), np.nan) if board is None else self.contrast(board, u, depth)
        values = (u, peak, width, beside, self.edges(record.angle, depth, u), np.zeros(len(u), int), contrast)
        for grid, value in zip(out, values, strict=True):
            grid[:, 0] = value
        return truth.with_parts(out, record.laser)


def header(config: SimulationConfig, kind: str) -> jaxscan.CaptureHeader:
    """The header of a capture."""
    sensor = config.sensor.model_dump(include={"pixel_format", "response"})
    fields: dict[str, Any] = {
        "kind": kind,
        "camera": config.camera.model_dump(include={"width", "height", "up"}) | sensor,
        "turntable": {"carries": config.turntable.carries},
        "laser": [laser.model_dump(include={"name", "colour", "stripe_axis"}) for laser in config.laser],
        "acquisition": {"software": "experiments.unkind.simulated"},
    }
    if kind == "calibration":
        names = {"type", "columns", "rows", "square_mm", "marker_mm", "dictionary"}
        fields["board"] = config.boards.model_dump(include=names)
    return jaxscan.CaptureHeader.model_validate(fields)


def true_world(config: SimulationConfig, rig: TrueRig, angles: np.ndarray) -> truth.Truth:
    """The numbers of the rig and of the walls."""
    sheet, sensor = rig.sheets[0], config.sensor
    frame = np.asarray(true_scanner(config).scanner_from_camera())
    planes = {plane["name"]: plane for plane in simulation_truth(config)["room"]["planes"]}
    walls = [planes[name] for name in ("wall x0", "wall x1", "wall y0", "wall y1")]
    normals = np.array([wall["normal"] for wall in walls])
    distances = np.array([wall["distance_m"] for wall in walls])
    lens = Rows(rig, None).lens
    table = true_scanner(config).turntable
    assert config.room is not None
    return truth.Truth(
        size=np.array([config.camera.width, config.camera.height]),
        lens=lens,
        normal=np.asarray(sheet.normal),
        distance=np.array(sheet.distance),
        bow=np.array(sheet.spec.bow),
        direction=np.asarray(table.direction),
        point=np.asarray(table.point),
        angles=angles,
        turned=np.array([rig.theta(float(phi)) for phi in angles]),
        dimensions=np.array(config.room.size_m[:2]),
        wall_normals=normals @ frame[:3, :3],
        wall_distances=distances - normals @ frame[:3, 3],
        wall_surfaces=np.full(4, -1),
        panels=PANELS,
        noise=np.array([sensor.electrons_per_dn, sensor.read_dn, sensor.black_dn, pixel_contrast(config)]),
    )


def render(seed: int, folder: Path) -> None:
    """Write the world of a seed; the folder must not exist."""
    render_config(draw_config(seed), folder)


def render_config(config: SimulationConfig, folder: Path) -> None:
    """Write a world; the folder must not exist."""
    folder.mkdir(parents=True)
    rig, scene, rng = make_rig(config), make_scene(config), np.random.default_rng([config.seed, 42])
    rows = Rows(rig, scene)
    picture = make_print(config.boards, board_texture(config.boards.board(), TEXTURE_PX))

    def take(capture: Any, record: ExpectedRecord, board: SeenBoard | None) -> truth.TrueStripes:
        pair = develop(record, config, rng)
        angle = float(np.degrees(pair.angle))
        capture.append(angle_deg=angle, on=pair.on, off=pair.off, placement=pair.placement, lasers=["red"])
        return rows.stripes(record, board)

    found = []
    with jaxscan.create_capture(folder / "boards", header(config, "calibration"), durable=False) as capture:
        for placement in plan_boards(rig, scene, rng):
            for phi in placement.angles:
                seen: Motion = placement.scanner_from_board.inverse() @ rig.pose(phi)
                board = SeenBoard(picture, seen)
                record = expect_record(rig, scene, phi, board=board, placement=placement.number)
                found.append(take(capture, record, board))
    boards = truth.TrueStripes(*(np.stack(parts) for parts in zip(*found, strict=True)))
    found, angles = [], sweep_angles(config)
    with jaxscan.create_capture(folder / "sweep", header(config, "sweep"), durable=False) as capture:
        found = [take(capture, expect_record(rig, scene, float(phi)), None) for phi in angles]
    sweep = truth.TrueStripes(*(np.stack(parts) for parts in zip(*found, strict=True)))
    truth.save(folder / "truth.npz", true_world(config, rig, angles), sweep, boards)


if __name__ == "__main__":
    render_seed(render, __doc__)
