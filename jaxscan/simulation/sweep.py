"""Frames of the camera while the table turns, or while a board is shown to it."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

import numpy as np

from jaxscan.simulation.boards import SeenBoard
from jaxscan.simulation.planning import Placement, plan_boards
from jaxscan.simulation.printing import make_print
from jaxscan.simulation.records import ExpectedRecord, RenderedRecord, develop, expect_record
from jaxscan.simulation.rig import make_rig
from jaxscan.simulation.scene import Scene, make_scene
from jaxscan.simulation.settings import SimulationConfig


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
    return _boards(config, texture, config.seed if seed is None else seed, lambda _, record: record)


def _boards(
    config: SimulationConfig, texture: np.ndarray, seed: int, finish: Callable[[int, ExpectedRecord], Result]
) -> Iterator[Result]:
    """What is made of the records of a board capture and their numbers, in order."""
    rig, scene = make_rig(config), make_scene(config, boards=config.object is not None)
    picture = make_print(config.boards, texture)
    placements = plan_boards(rig, scene, _generator(seed, _PLAN, 0))
    jobs = [(one, phi, index) for one in placements for phi in one.angles for index in range(len(rig.sheets))]

    def make(job: tuple[int, tuple[Placement, float, int]]) -> Result:
        number, (placement, phi, index) = job
        pose = rig.pose(rig.stood(phi, placement.number))
        board = SeenBoard(picture, placement.scanner_from_board.inverse() @ pose)
        return finish(number, expect_record(rig, scene, phi, laser=index, board=board, placement=placement.number))

    return _ahead(make, enumerate(jobs))


def render_sweep(
    config: SimulationConfig,
    *,
    every: int = 1,
    seed: int | None = None,
    angles: np.ndarray | None = None,
    scene: Scene | None = None,
) -> Iterator[RenderedRecord]:
    """The frames of a sweep, in order.

    Args:
        config: The rig and its room.
        every: Only every n-th step.
        seed: Of the noise, instead of the configuration's. The same seed gives the same frames,
            whatever `every` is.
        angles: Commanded angles [rad], instead of those of the plan.
        scene: What the rig sees, instead of the configuration's room alone; see `make_scene`.
    """
    seed = config.seed if seed is None else seed
    rig, scene = make_rig(config), make_scene(config) if scene is None else scene
    lasers, angles = len(rig.sheets), sweep_angles(config, every=every) if angles is None else angles[::every]
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
    return _boards(
        config, texture, seed, lambda number, record: develop(record, config, _generator(seed, _BOARDS, number))
    )


def true_cloud(records: Iterable[ExpectedRecord | RenderedRecord]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cloud of a perfect scanner.

    Returns:
        xyz: float64 [records, lines, 3], m, scanner frame; zero where not valid.
        valid: bool [records, lines].
        angle: float64 [records], rad.
    """
    angles, points, valid = zip(*((one.angle, one.truth.xyz, one.truth.valid) for one in records), strict=True)
    return np.stack(points), np.stack(valid), np.array(angles)


def _generator(seed: int, stream: int, number: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, stream, number])))


def _ahead(function: Callable[[Item], Result], items: Iterable[Item], *, workers: int = 2) -> Iterator[Result]:
    """`map` in order, a few items ahead in threads: NumPy and Embree release the interpreter's lock."""
    waiting = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        running = deque(pool.submit(function, item) for item in islice(waiting, workers + 1))
        while running:
            result = running.popleft().result()
            running.extend(pool.submit(function, item) for item in islice(waiting, 1))
            yield result
