"""A world nobody here made: a furnished room and boards, path traced by Mitsuba 3, written as captures.

    python -m experiments.unkind.path_traced SEED FOLDER

FOLDER/boards and FOLDER/sweep are captures in the format of docs/formats.md; FOLDER/truth.npz is beside them. Of
jaxscan only the writer of captures is used: `scene` draws the rig, the room, the boards and the sensor, in NumPy
alone, and `tracer` asks Mitsuba. That needs `pip install -e '.[worlds]'` and a libLLVM of the system, 16 or newer
(`libllvm19` on Debian; LLVM 15 crashes). Whoever judges worlds needs neither.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxscan
from experiments.unkind import truth
from experiments.unkind.scene import (
    FINE,
    Board,
    Rig,
    Room,
    Sensor,
    Speckle,
    View,
    blurred,
    draw_board,
    draw_rig,
    draw_room,
    draw_views,
    expose,
    look,
    to_pixels,
)
from experiments.unkind.tracer import Direct, Hits, Shot, Tracer, bilinear, direct, light_points, stripes, thickness
from experiments.unkind.truth import render_seed


STEPS = 90
WALL_DN = 110.0
"""Peak of the stripe on a wall of reflectance 0.65 at 2 m in a sweep [DN]."""
BOARD_WHITE_DN, SWEEP_WHITE_DN = 120.0, 45.0
"""Brightness of white paper in the room's light, where it is usual; a sweep is made in dim light."""
SAMPLES = 4
"""Rays in a quarter of a pixel around a board."""
COARSE = 10
"""Pixels between the points at which light from other surfaces is gathered."""


class World(NamedTuple):
    """All that a seed draws."""

    rig: Rig
    room: Room
    board: Board
    sensor: Sensor
    speckle: Speckle
    rng: np.random.Generator


class Pair(NamedTuple):
    """Frames, and the light behind them without noise [DN above black]."""

    on: np.ndarray
    off: np.ndarray
    laser: Direct
    """Behind the lens."""
    ambient: np.ndarray
    middle: Hits


@lru_cache(maxsize=64)
def grid_ways(lens: tuple[float, ...], size: tuple[int, int], du: float, dv: float, cells: int) -> np.ndarray:
    """Directions [n, 3] in the camera's frame of points in all cells of all pixels, shifted by (du, dv) px, float32."""
    v, u = (part.ravel() for part in np.mgrid[: cells * size[1], : cells * size[0]])
    way = look(np.array(lens), (u + 0.5) / cells - 0.5 + du, (v + 0.5) / cells - 0.5 + dv)
    return (way / np.linalg.norm(way, axis=1, keepdims=True)).astype(np.float32)


def ways(rig: Rig, du: float = 0.0, dv: float = 0.0, cells: int = 1) -> np.ndarray:
    """`grid_ways` of a rig."""
    return grid_ways(tuple(map(float, rig.lens)), (rig.width, rig.height), du, dv, cells)


def ambient(shot: Shot, sensor: Sensor, board_light: Any | None) -> np.ndarray:
    """The lamps' light on every pixel behind the lens, in units of a white surface under a light of pi.

    Two by two cells per pixel; around a board each has four rays, whose rows and columns all differ.
    """
    rows, columns = 2 * shot.rig.height, 2 * shot.rig.width

    def glow(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shape, albedo, uv = shot.tracer.painted(shot.pose[:3, 3], shot.turned(way))
        light, on_board = shot.tracer.ambient(shape, uv), np.flatnonzero(shape == shot.tracer.board)
        if board_light is not None:
            light[on_board] = board_light(uv[on_board])
        return light * albedo / np.float32(np.pi), on_board

    total, on_board = glow(ways(shot.rig, 0.0, 0.0, 2))
    if board_light is not None and len(on_board):
        v, u = np.divmod(on_board, columns)
        fine = (slice(v.min(), v.max() + 1), slice(u.min(), u.max() + 1))
        offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES / 2 - 0.25
        several = 0.0
        for du, dv in zip(offsets[[1, 3, 0, 2]], offsets, strict=True):
            way = ways(shot.rig, float(du), float(dv), 2).reshape(rows, columns, 3)[fine]
            several = several + glow(way.reshape(-1, 3))[0] / np.float32(SAMPLES)
        total.reshape(rows, columns)[fine] = several.reshape(fine[0].stop - fine[0].start, -1)
    return to_pixels(blurred(total.reshape(rows, columns), sensor, 2), 2)


def board_light(tracer: Tracer) -> Any:
    """Irradiance on the board by its uv: a quadratic surface through path-traced points."""
    patch = tracer.patches[tracer.board]
    v, u = (part.ravel() for part in (np.mgrid[0.5:6, 0.5:8] / np.array([6, 8])[:, None, None]))
    p = patch.origin + u[:, None] * patch.along + v[:, None] * patch.up
    value = tracer.lamp_light(p, np.broadcast_to(patch.normal(), p.shape), 256)

    def terms(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)

    weights = np.linalg.lstsq(terms(u, v), value, rcond=None)[0]
    return lambda uv: terms(uv[:, 0], uv[:, 1]) @ weights


def from_others(shot: Shot, middle: Hits, rng: np.random.Generator) -> np.ndarray:
    """The laser's light that comes back from other surfaces, albedo included, on every pixel."""
    rows, columns = shot.rig.height, shot.rig.width
    points = shot.tracer.bounced(light_points(shot, rng), rng)
    v, u = np.mgrid[COARSE // 2 : rows : COARSE, COARSE // 2 : columns : COARSE]
    chosen = (v * columns + u).ravel()
    value = shot.tracer.gather(points, middle.p[chosen], middle.normal[chosen]).reshape(v.shape)
    at_v, at_u = (part.ravel() for part in np.mgrid[:rows, :columns])
    places = np.stack([(at_u + 0.5) / (COARSE * v.shape[1]), (at_v + 0.5) / (COARSE * v.shape[0])], -1)
    return (bilinear(value, places) * middle.albedo).reshape(rows, columns)


def falloff(rig: Rig) -> np.ndarray:
    """Natural vignetting: the fourth power of the cosine [rows, columns]."""
    v, u = np.mgrid[: rig.height, : rig.width]
    x, y = (u - rig.lens[2]) / rig.lens[0], (v - rig.lens[3]) / rig.lens[1]
    return (1 + x**2 + y**2) ** -2.0


def take(world: World, shot: Shot, power: float, white: float, glow: Any | None = None) -> Pair:
    """A pair of frames; `power` and `white` are in DN per unit of laser's and lamps' light."""
    rig, sensor, rng = world.rig, world.sensor, world.rng
    middle = shot.tracer.cast(shot.pose[:3, 3], shot.turned(ways(rig)))
    vignette = falloff(rig)
    room = white * vignette * ambient(shot, sensor, glow)
    straight = direct(shot, middle)
    here = straight.columns
    gain = np.repeat(np.repeat((power * vignette[:, here]).astype(np.float32), FINE, 0), FINE, 1)
    laser = gain * blurred(straight.fine, sensor, FINE, (here, rig.width))
    on = room + power * vignette * from_others(shot, middle, rng)
    on[:, here] += to_pixels(laser * world.speckle.draw(laser.shape), FINE)
    return Pair(expose(on, sensor, rng), expose(room, sensor, rng), straight._replace(fine=laser), room, middle)


def draw_world(seed: int) -> World:
    """A world from its seed."""
    rng = np.random.default_rng([seed, 14])
    rig = draw_rig(rng)
    room = draw_room(rng)
    board, sensor = draw_board(rng), Sensor()
    return World(rig, room, board, sensor, Speckle(sensor, (rig.height, rig.width), rng), rng)


def wall_power(rig: Rig, peak: float, far: float, albedo: float, sensor: Sensor) -> float:
    """Factor that gives a facing surface a stripe of this peak behind the lens [DN]."""
    width = thickness(np.array([far]))[0]
    seen = np.hypot(width, sensor.blur_px[0] * far / rig.lens[0])
    return float(peak / albedo * far * np.sqrt(2 * np.pi) * seen)


def header(world: World, kind: str) -> jaxscan.CaptureHeader:
    """The header of a capture."""
    camera = {"width": world.rig.width, "height": world.rig.height, "pixel_format": "mono8"}
    fields: dict[str, Any] = {
        "kind": kind,
        "camera": camera | {"response": "linear", "up": "-v"},
        "turntable": {"carries": "scanner"},
        "laser": [{"name": "red", "colour": "red", "stripe_axis": "rows"}],
        "acquisition": {"software": "experiments.unkind.path_traced"},
    }
    if kind == "calibration":
        fields["board"] = world.board.header()
    return jaxscan.CaptureHeader.model_validate(fields)


def render_boards(world: World, tracer: Tracer, views: list[View], folder: Path) -> truth.TrueStripes:
    """Write the capture of boards, and return its true stripes."""
    found = []
    with jaxscan.create_capture(folder / "boards", header(world, "calibration"), durable=False) as capture:
        for view in views:
            tracer.move_board(world.board.patch(view.room_board))
            shot = Shot(world.rig, tracer, world.room.camera @ world.rig.pose(view.phi))
            middle = view.room_board @ np.array([*world.board.size / 2, 0, 1])
            far = float(np.linalg.norm(shot.local(middle[:3])))
            peak = world.rng.uniform(60, 100)
            power = wall_power(world.rig, peak, far, 0.8, world.sensor)
            glow = board_light(tracer)
            white = BOARD_WHITE_DN * np.pi / 0.8 / float(glow(np.array([[0.5, 0.5]]))[0])
            pair = take(world, shot, power, white, glow)
            capture.append(angle_deg=float(np.degrees(view.phi)), on=pair.on, off=pair.off, placement=view.placement)
            found.append(stripes(shot, pair.middle, pair.laser, pair.ambient))
    return truth.TrueStripes(*(np.stack(parts) for parts in zip(*found, strict=True)))


def render_sweep(world: World, tracer: Tracer, angles: np.ndarray, folder: Path) -> truth.TrueStripes:
    """Write the capture of the sweep, and return its true stripes."""
    found = []
    power = wall_power(world.rig, WALL_DN, 2.0, 0.65, world.sensor)
    usual = np.median(np.concatenate([grid.ravel() for grid in tracer.maps[:4]]))
    white = SWEEP_WHITE_DN * np.pi / usual
    with jaxscan.create_capture(folder / "sweep", header(world, "sweep"), durable=False) as capture:
        for phi in angles:
            shot = Shot(world.rig, tracer, world.room.camera @ world.rig.pose(float(phi)))
            pair = take(world, shot, power, white)
            capture.append(angle_deg=float(np.degrees(phi)), on=pair.on, off=pair.off)
            found.append(stripes(shot, pair.middle, pair.laser, pair.ambient))
    return truth.TrueStripes(*(np.stack(parts) for parts in zip(*found, strict=True)))


def true_world(world: World, angles: np.ndarray) -> truth.Truth:
    """The numbers of the rig and of the walls."""
    rig, room, sensor = world.rig, world.room, world.sensor
    names = [patch.name for patch in room.patches]
    pairs = ["wall x0", "wall x1", "wall y0", "wall y1"]
    walls = [room.patches[names.index(name)] for name in pairs]
    turn, eye = room.camera[:3, :3], room.camera[:3, 3]
    normals = np.array([wall.normal() for wall in walls])
    distances = np.array([wall.normal() @ (wall.origin - eye) for wall in walls])
    # Fronts of the three panels: the patch of each box that looks into the room, and the wall behind.
    panels = []
    for panel, wall in enumerate(("wall x0", "wall y0", "wall x1")):
        behind = room.patches[names.index(wall)]
        fronts = [k for k, patch in enumerate(room.patches) if patch.name.startswith(f"panel {panel} ")]
        front = next(k for k in fronts if np.allclose(room.patches[k].normal(), behind.normal()))
        panels.append((front, names.index(wall)))
    return truth.Truth(
        size=np.array([rig.width, rig.height]),
        lens=rig.lens,
        normal=rig.normal,
        distance=np.array(rig.distance),
        bow=np.zeros(2),
        direction=rig.direction,
        point=rig.point,
        angles=angles,
        turned=np.array([rig.theta(float(phi)) for phi in angles]),
        dimensions=room.size[:2],
        wall_normals=normals @ turn,
        wall_distances=distances,
        wall_surfaces=np.array([names.index(name) for name in pairs]),
        panels=np.array(panels),
        noise=np.array([sensor.electrons_per_dn, sensor.read_dn, sensor.black_dn, sensor.speckle]),
    )


def render(seed: int, folder: Path) -> None:
    """Write a world; the folder must not exist."""
    folder.mkdir(parents=True)
    world = draw_world(seed)
    plain = Tracer(world.room, seed)
    plain.bake()
    views = draw_views(world.rig, world.board, world.room.camera, world.rng)
    boards = Tracer(world.room, seed, world.board.patch(views[0].room_board))
    boards.maps = [*plain.maps[: boards.board], np.zeros((0, 0)), *plain.maps[boards.board :]]
    boards_truth = render_boards(world, boards, views, folder)
    angles = 2 * np.pi * np.arange(STEPS) / STEPS
    sweep_truth = render_sweep(world, plain, angles, folder)
    truth.save(folder / "truth.npz", true_world(world, angles), sweep_truth, boards_truth)


if __name__ == "__main__":
    render_seed(render, __doc__)
