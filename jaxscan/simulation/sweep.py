"""Frames of the camera while the table turns, or while a board is shown to it."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import NamedTuple, TypeVar

import numpy as np

from jaxscan.simulation.boards import SeenBoard, cover, make_print
from jaxscan.simulation.camera import blur, channels, expose, laser_response, mosaic
from jaxscan.simulation.light import LitSamples, LitScene, RowTruth, laser_image, lit_samples, row_truth, speckle_light
from jaxscan.simulation.planning import Placement, plan_boards
from jaxscan.simulation.rig import WALL_ALBEDO, Motion, Sheet, TrueRig, make_rig
from jaxscan.simulation.scene import Scene, make_scene
from jaxscan.simulation.settings import SimulationConfig


class ExpectedRecord(NamedTuple):
    """A pair of frames before the sensor: linear light in DN, without noise."""

    angle: float
    """The table's own count [rad]."""
    placement: int | None
    """Which placement of the board; None for free views and sweeps."""
    off: np.ndarray
    """The room's light, float32 [rows, columns] (rgb8: and 3)."""
    laser: np.ndarray
    """The laser's light, of the same shape: the laser-on frame expects `off + laser`."""
    truth: RowTruth
    laser_index: int
    samples: LitSamples | None = None
    """The laser's light before the lens, where it has speckle."""


class RenderedRecord(NamedTuple):
    """A pair of frames, and the truth for comparison."""

    angle: float
    """The table's own count [rad]."""
    placement: int | None
    on: np.ndarray
    """uint8 [rows, columns] (rgb8: and 3)."""
    off: np.ndarray
    truth: RowTruth
    laser_index: int = 0


_SWEEP, _BOARDS, _PLAN = 0, 1, 2
"""Streams of random numbers that are drawn from one seed."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def sweep_angles(config: SimulationConfig, *, every: int = 1) -> np.ndarray:
    """Commanded angles of a sweep [rad], every n-th step.

    Raises:
        ValueError: If `every` is less than 1.
    """
    if every < 1:
        raise ValueError(f"`every` must be at least 1, got {every}.")
    plan = config.plan
    return np.deg2rad(plan.turn_deg) * np.arange(0, plan.steps, every) / plan.steps


def board_pairs(config: SimulationConfig) -> int:
    """How many pairs of frames a board capture has."""
    spec = config.boards
    return (spec.free_views + spec.placements * spec.angles) * len(config.laser)


def expect_sweep(config: SimulationConfig, *, every: int = 1) -> Iterator[ExpectedRecord]:
    """The frames of a sweep without noise, in order; with several lasers, one after the other at each angle."""
    rig, scene = make_rig(config), make_scene(config)
    jobs = [(float(phi), index) for phi in sweep_angles(config, every=every) for index in range(len(rig.sheets))]
    return _ahead(lambda job: expect_record(rig, scene, job[0], laser=job[1]), jobs)


def expect_boards(
    config: SimulationConfig, texture: np.ndarray, *, seed: int | None = None
) -> Iterator[ExpectedRecord]:
    """The frames of a board capture without noise; `seed` chooses the poses.

    Args:
        config: The rig.
        texture: Picture of the board's printed area, uint8 [rows, columns]; see `render_boards`.
        seed: Instead of the configuration's.
    """
    rig, scene = make_rig(config), make_scene(config, boards=config.object is not None)
    picture = make_print(config.boards, texture)
    placements = plan_boards(rig, scene, _generator(config.seed if seed is None else seed, _PLAN, 0))

    def expect(job: tuple[Placement, float, int]) -> ExpectedRecord:
        placement, phi, index = job
        board = SeenBoard(picture, placement.scanner_from_board.inverse() @ rig.pose(phi))
        return expect_record(rig, scene, phi, laser=index, board=board, placement=placement.number)

    return _ahead(expect, [(one, phi, n) for one in placements for phi in one.angles for n in range(len(rig.sheets))])


def render_sweep(config: SimulationConfig, *, every: int = 1, seed: int | None = None) -> Iterator[RenderedRecord]:
    """The frames of a sweep, in order.

    Args:
        config: The rig and its room.
        every: Only every n-th step.
        seed: Of the noise, instead of the configuration's. The same seed gives the same frames,
            whatever `every` is.
    """
    seed = config.seed if seed is None else seed
    rig, scene = make_rig(config), make_scene(config)
    lasers, angles = len(rig.sheets), sweep_angles(config, every=every)
    jobs = [(k * every * lasers + index, float(phi), index) for k, phi in enumerate(angles) for index in range(lasers)]

    def render(job: tuple[int, float, int]) -> RenderedRecord:
        number, phi, index = job
        return develop(expect_record(rig, scene, phi, laser=index), config, _generator(seed, _SWEEP, number))

    return _ahead(render, jobs)


def render_boards(
    config: SimulationConfig, texture: np.ndarray, *, seed: int | None = None
) -> Iterator[RenderedRecord]:
    """The frames of a board capture: free views at angle 0, then the placements.

    Args:
        config: The rig and its board.
        texture: Picture of the board's printed area (`board.outline()`), uint8 [rows, columns],
            row 0 at y0 and column 0 at x0, with a whole number of cells per square.
        seed: Of poses and noise, instead of the configuration's.
    """
    seed = config.seed if seed is None else seed
    for number, record in enumerate(expect_boards(config, texture, seed=seed)):
        yield develop(record, config, _generator(seed, _BOARDS, number))


def develop(record: ExpectedRecord, config: SimulationConfig, rng: np.random.Generator) -> RenderedRecord:
    """Expose both frames of a record, each with its own noise."""
    laser = speckled(record, config, rng)
    on = expose(record.off + laser, config.sensor, rng)
    off = expose(record.off, config.sensor, rng)
    return RenderedRecord(record.angle, record.placement, on, off, record.truth, record.laser_index)


def speckled(record: ExpectedRecord, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """The laser's light of a record with a pattern of speckle of its own; of the shape of `record.laser`."""
    sensor, spec = config.sensor, config.laser[record.laser_index]
    if record.samples is None:
        return record.laser
    change = speckle_light(record.samples, spec.grain_px(sensor), spec.speckle_contrast, rng)
    change = mosaic(change * laser_response(sensor, spec.colour)[:, None, None], sensor.pixel_format)
    return np.where(record.laser > 0, np.maximum(record.laser + change, 0), np.float32(0))


def expect_record(
    rig: TrueRig,
    scene: Scene,
    phi: float,
    *,
    laser: int = 0,
    board: SeenBoard | None = None,
    placement: int | None = None,
) -> ExpectedRecord:
    """One pair of frames at the table's angle `phi` [rad], without noise."""
    config, sensor, sheet = rig.config, rig.config.sensor, rig.sheets[laser]
    pose, sees = rig.pose(phi), rig.rays.sees
    rays = pose.turn(rig.rays.vectors)

    def in_view(depth: np.ndarray) -> np.ndarray:
        return depth if sees is None else np.where(sees, depth, np.float32(np.inf))

    depth, triangle = (part.reshape(rig.rays.shape) for part in scene.cast(pose.translation, rays))
    depth = in_view(depth)
    white = config.light.white_dn if board is None else config.boards.white_dn
    off = _ambient(rig, scene, pose, rays, depth, triangle) * np.float32(white)
    scale = 1.0
    if board is not None:
        in_front = in_view(board.hit(rig.rays.x, rig.rays.y, rig.rays.z)[0])
        where, fills, albedo, board = cover(rig, board, in_front)
        light = _board_light(rig, scene, pose, board, where) * np.float32(white)
        off[:, *where] = off[:, *where] * (1 - fills) + albedo * light
        depth = np.minimum(depth, in_front)
        scale = _board_power(rig, sheet, in_front)
    shot = LitScene(rig, sheet, scene, pose, board)
    samples = lit_samples(shot, depth)
    glow = laser_image(samples) * np.float32(scale)
    if sees is not None:
        # Nothing comes through the lens from beyond its field of view.
        off, glow = off * sees, glow * sees
    truth = row_truth(shot, depth, glow)
    lit = glow * laser_response(sensor, sheet.spec.colour)[:, None, None]
    pixel_format = sensor.pixel_format
    frames = mosaic(off, pixel_format), mosaic(lit, pixel_format)
    kept = samples._replace(light=samples.light * np.float32(scale)) if sheet.spec.speckle_contrast > 0 else None
    return ExpectedRecord(phi, placement, *frames, truth, laser, kept)


def true_cloud(records: Iterable[ExpectedRecord | RenderedRecord]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cloud of a perfect scanner.

    Returns:
        xyz: float64 [records, lines, 3], m, scanner frame; zero where not valid.
        valid: bool [records, lines].
        angle: float64 [records], rad.
    """
    angles, points, valid = zip(*((one.angle, one.truth.xyz, one.truth.valid) for one in records), strict=True)
    return np.stack(points), np.stack(valid), np.array(angles)


def _ambient(
    rig: TrueRig, scene: Scene, pose: Motion, rays: np.ndarray, depth: np.ndarray, triangle: np.ndarray
) -> np.ndarray:
    """The scene in its own light through the lens, float32 [channels, height, width]; 1 is white."""
    hit = np.isfinite(depth)
    points = rays * np.where(hit, depth, np.float32(0)).reshape(-1, 1) + pose.translation.astype(np.float32)
    image = scene.ambient(triangle, points.reshape(*hit.shape, 3), pose.translation, channels(rig.config.sensor))
    if not hit.all():
        image *= hit
    return blur(image, rig.config.sensor.psf_px)


def _board_light(rig: TrueRig, scene: Scene, pose: Motion, board: SeenBoard, where: tuple[slice, slice]) -> np.ndarray:
    """The room's light on the board's plane at pixel centres, float32 [rows, columns]."""
    rays = rig.rays.at(*where)
    r2 = board.board_from_camera.rotation[2].astype(np.float32)
    depth = np.float32(-board.board_from_camera.translation[2]) / (r2[0] * rays.x + r2[1] * rays.y + r2[2] * rays.z)
    points = pose.apply(np.stack([rays.x * depth, rays.y * depth, rays.z * depth], -1))
    normal = np.broadcast_to((pose.rotation @ board.normal()).astype(np.float32), points.shape)
    return scene.light(points, normal, pose.translation)


def _board_power(rig: TrueRig, sheet: Sheet, depth: np.ndarray) -> float:
    """Factor on the laser's power that makes its stripe on the board as bright as wanted."""
    spec, laser = rig.config.boards, sheet.spec
    seen = depth[np.isfinite(depth)]
    if not len(seen):
        return 1.0
    psf2 = rig.config.sensor.psf_px**2 + 1 / 12

    def strength(r: float) -> float:
        width_px = float(sheet.thickness(np.array([r]))[0]) * rig.config.camera.fx / r
        # Light per metre of stripe, on pixels of r / f, spread over the seen width.
        return 1 / np.sqrt(width_px**2 + psf2) * rig.config.camera.fx / r**2

    return (
        spec.peak_dn / 0.85 / (laser.peak_dn / WALL_ALBEDO) * strength(laser.range_m) / strength(float(np.median(seen)))
    )


def _generator(seed: int, stream: int, number: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, stream, number])))


def _ahead(function: Callable[[Item], Result], items: Iterable[Item], *, workers: int = 2) -> Iterator[Result]:
    """`map` in order, a few items ahead in threads: NumPy and Open3D release the interpreter's lock."""
    waiting = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        running = deque(pool.submit(function, item) for item in islice(waiting, workers + 1))
        while running:
            result = running.popleft().result()
            running.extend(pool.submit(function, item) for item in islice(waiting, 1))
            yield result
