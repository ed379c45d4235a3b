"""Captures of boards by the paper's protocol and by ours: rendered once, then with many draws of noise."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.paper.stage import Stage
from jaxscan.api.simulation import TEXTURE_PX
from jaxscan.errors import ConfigError
from jaxscan.files import CaptureHeader, create_capture
from jaxscan.simulation import (
    ExpectedRecord,
    Placement,
    SeenBoard,
    SimulationConfig,
    develop,
    expect_record,
    make_print,
    make_rig,
    make_scene,
    plan_boards,
    take_frame,
)
from jaxscan.vision import board_texture


PAIR_DEG = 1.98
"""Turn between the paper's last two views: that of Table I's Tr."""
VIEWS, LIT = 23, 4
"""Views of the paper's protocol, and how many of them, the last ones, show the stripe."""
CAMERA_RANGE_M = (0.9, 2.0)
"""Distances of the views without a stripe: the board fills the image, or a fifth of it."""
STRIPE_RANGE_M = (1.0, 1.6)
"""Distances of the views with a stripe: round the paper's working distance, 1.3 m."""
_PLAN, _NOISE = 11, 12
"""Streams of random numbers."""


class BoardPlan(NamedTuple):
    """Where boards stand, and which views show the stripe."""

    placements: list[Placement]
    lit: list[bool]
    """Of each record: every placement at each of its angles, in this order."""

    def jobs(self) -> list[tuple[Placement, float, bool]]:
        """Placement, angle [rad] and whether it is lit, of each record."""
        views = [(placement, phi) for placement in self.placements for phi in placement.angles]
        return [(*view, lit) for view, lit in zip(views, self.lit, strict=True)]


def paper_plan(stage: Stage) -> BoardPlan:
    """23 views: 19 without a laser, then 4 with the stripe, of which the last two show one board, 1.98 degrees apart.

    The paper reports the numbers of views and their purposes alone. Assumed are: a board of 11 x 8 corners, 40 mm
    apart, tilted by 20 to 45 degrees; distances of 0.9 to 2 m for the camera, and of 1 to 1.6 m with the stripe, around
    a working distance of 1.3 m. There a stripe of Table II's plane crosses the middle of the image, in agreement with
    the ratios of X and Y to Z in the paper's Fig. 6.

    Raises:
        ConfigError: If no board stays in the image while the table turns by 1.98 degrees.
    """
    views = _planned(stage, 0, free_views=VIEWS - LIT, placements=0, range_m=CAMERA_RANGE_M)
    for attempt in range(1, 20):
        stripes = {"free_views": LIT - 2, "placements": 1, "angles": 2, "range_m": STRIPE_RANGE_M}
        *lit, pair = _planned(stage, attempt, **stripes)
        # The planner gives the ends of the arc in which the camera sees all of the board; home is inside.
        if max(pair.angles) >= np.deg2rad(PAIR_DEG):
            pair = pair._replace(angles=(0.0, float(np.deg2rad(PAIR_DEG))))
            return BoardPlan([*views, *lit, pair], [False] * (VIEWS - LIT) + [True] * LIT)
    raise ConfigError("No board was found that the camera sees before and after the turn of the last pair.")


def our_plan(stage: Stage) -> BoardPlan:
    """The protocol of jaxscan's own guide, as in the configuration: every view with the stripe."""
    few = {"free_views": 9, "placements": 2, "angles": 4} if stage.quick else {}
    placements = _planned(stage, 100, **few)
    return BoardPlan(placements, [True] * sum(len(each.angles) for each in placements))


def expect(stage: Stage, plan: BoardPlan) -> list[ExpectedRecord]:
    """All frames of a plan without noise: in full size 13 MB a view, and 13 MB more for the laser's light."""
    return list(expect_each(stage, plan))


def expect_each(stage: Stage, plan: BoardPlan) -> Iterator[ExpectedRecord]:
    """All frames of a plan without noise, one view at a time. Records that are not lit have an empty `laser`."""
    config = stage.config
    rig, dark, scene = make_rig(config), make_rig(_plain(config)), make_scene(config)
    picture = make_print(config.boards, board_texture(config.boards.board(), TEXTURE_PX))
    for placement, phi, lit in plan.jobs():
        board = SeenBoard(picture, placement.scanner_from_board.inverse() @ rig.pose(phi))
        record = expect_record(rig if lit else dark, scene, phi, board=board, placement=placement.number)
        yield record if lit else record._replace(laser=np.zeros(0, np.float32), samples=())


def write_capture(stage: Stage, records: Sequence[ExpectedRecord], plan: BoardPlan, seed: int, folder: Path) -> Path:
    """One draw of noise, as a capture on disk.

    Args:
        stage: The world.
        records: Of `expect`.
        plan: Theirs.
        seed: Of the noise: the same seed writes the same frames.
        folder: Must not exist.

    Returns:
        The folder.
    """
    (path,) = write_captures(stage, iter(records), plan, {seed: folder})
    return path


def write_captures(
    stage: Stage, records: Iterator[ExpectedRecord], plan: BoardPlan, folders: dict[int, Path]
) -> list[Path]:
    """Several draws at once; records are taken one by one and not kept.

    Args:
        stage: The world.
        records: Of `expect_each`.
        plan: Theirs.
        folders: Of the draws, by their seeds; must not exist.

    Returns:
        The folders.
    """
    config = stage.config
    header = _header(config, len(plan.lit))
    with ExitStack() as stack:
        # Raw frames: packing them would take longer than all else. None is kept for long.
        writers = {
            seed: stack.enter_context(create_capture(folder, header, storage="npy", durable=False))
            for seed, folder in folders.items()
        }
        for number, (record, lit) in enumerate(zip(records, plan.lit, strict=True)):
            for seed, writer in writers.items():
                on, off = _frames(record, lit, config, stage.generator(_NOISE, seed, number))
                writer.append(
                    angle_deg=float(np.rad2deg(record.angle)),
                    on=on,
                    off=off,
                    placement=record.placement,
                    lasers=[config.laser[0].name],
                )
    return list(folders.values())


def _planned(stage: Stage, number: int, **changes: object) -> list[Placement]:
    """Poses of the boards, with changes of the configuration's protocol."""
    config = stage.config.model_copy(update={"boards": stage.config.boards.model_copy(update=changes)})
    return plan_boards(make_rig(config), make_scene(config), stage.generator(_PLAN, number))


def _plain(config: SimulationConfig) -> SimulationConfig:
    """The same room's light, and a plain laser, which is rendered faster and then thrown away."""
    lasers = tuple(laser.model_copy(update={"speckle_contrast": 0.0}) for laser in config.laser)
    return config.model_copy(update={"light": config.light.model_copy(update={"bounce": 0.0}), "laser": lasers})


def _frames(
    record: ExpectedRecord, lit: bool, config: SimulationConfig, random: np.random.Generator
) -> tuple[np.ndarray | None, np.ndarray]:
    """Frames on and off with noise; no frame on where the laser was not lit."""
    if lit:
        both = develop(record, config, random)
        return both.on, both.off
    flicker = max(0.0, 1 + config.light.flicker * random.standard_normal())
    return None, take_frame(record.off * np.float32(flicker), config, random)


def _header(config: SimulationConfig, records: int) -> CaptureHeader:
    sensor = {"pixel_format": config.sensor.pixel_format, "response": config.sensor.response}
    return CaptureHeader.model_validate(
        {
            "kind": "calibration",
            "camera": config.camera.model_dump(include={"width", "height", "up"}) | sensor,
            "turntable": {"carries": config.turntable.carries},
            "laser": [laser.model_dump(include={"name", "colour", "stripe_axis"}) for laser in config.laser],
            "board": config.boards.table(),
            "plan": {"steps": records},
            "acquisition": {"software": "jaxscan simulate"},
        }
    )
