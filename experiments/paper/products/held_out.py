"""Boards that no calibration has seen, at the paper's working distance, in several draws of noise."""

import shutil
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.rendering.boards import BoardPlan, expect, write_capture
from experiments.paper.stage import Stage
from jaxscan.errors import ConfigError
from jaxscan.observation import Observations
from jaxscan.simulation import Motion, Placement, make_rig, rodrigues
from jaxscan.simulation.rig import project


WORKING_M = 1.3
"""Depth at which the paper's stripe crosses the middle of the image; see `figure_6`."""
_SEED = 2000
"""First seed of the noise; the calibrations have others."""
_STREAM = 31
_MARGIN_PX = 8


class HeldOut(NamedTuple):
    """Captures of the same boards, one for each draw."""

    captures: list[Path]
    true_u: np.ndarray
    """Where the sheet's centre meets each row, float64 [boards, rows], px: for comparison alone."""
    true_valid: np.ndarray


def held_out(stage: Stage) -> HeldOut:
    """Six boards in three draws of noise, three in one for a quick stage; made once."""
    boards, count = (3, 1) if stage.quick else (6, 3)
    truth = stage.product("held_out/truth.npz")
    captures = [stage.product(f"held_out/capture_{number}") for number in range(count)]
    if not truth.exists():
        plan = held_out_plan(stage, boards)
        records = expect(stage, plan)
        for number, folder in enumerate(captures):
            shutil.rmtree(folder, ignore_errors=True)
            write_capture(stage, records, plan, _SEED + number, folder)
        u, valid = (np.stack([getattr(record.truth, name) for record in records]) for name in ("u", "valid"))
        # Last: with this file all is there.
        np.savez(truth, u=u, valid=valid)
        stage.say(f"rendered {boards} boards at {WORKING_M} m, {count} draws of noise")
    with np.load(truth) as file:
        return HeldOut(captures, file["u"], file["valid"])


def held_out_plan(stage: Stage, boards: int) -> BoardPlan:
    """Boards that stand upright in the middle of the image, tilted by 20 to 35 degrees to all sides.

    The stripe then runs along the board's longer side, over about a sixth of the depth to both sides of the optical
    axis, in agreement with the ratios of X and Y to Z in the paper's Fig. 6.

    Args:
        stage: The world.
        boards: How many.

    Raises:
        ConfigError: If the camera does not see one whole.
    """
    rig, random = make_rig(stage.config), stage.generator(_STREAM)
    board, sheet = stage.config.boards.board(), rig.sheets[0]
    centre = np.append(board.outline().mean(0), 0.0)
    placements = []
    for number in range(boards):
        direction = 2 * np.pi * (number + random.uniform(-0.2, 0.2)) / boards
        tilt = rodrigues(np.array([np.cos(direction), np.sin(direction), 0.0]), np.deg2rad(random.uniform(20, 35)))
        rotation = tilt @ rodrigues(np.array([0.0, 0.0, 1.0]), np.deg2rad(90 + random.uniform(-8, 8)))
        y = random.uniform(-0.03, 0.03)
        x = (sheet.distance - sheet.normal[2] * WORKING_M - sheet.normal[1] * y) / sheet.normal[0]
        place = np.array([x + random.uniform(-0.08, 0.08), y, WORKING_M])
        pose = Motion(rotation, place - rotation @ centre)
        u, v = project(stage.config.camera, pose.apply(board.corners()))
        across, down = (size - 1 - _MARGIN_PX for size in (stage.config.camera.width, stage.config.camera.height))
        if not ((u > _MARGIN_PX) & (u < across) & (v > _MARGIN_PX) & (v < down)).all():
            raise ConfigError(f"The board at {WORKING_M} m does not fit into the image.")
        placements.append(Placement(rig.pose(0.0) @ pose, (0.0,), None))
    return BoardPlan(placements, [True] * boards)


@lru_cache(maxsize=4)
def observe_held_out(calibration: Path, capture: Path) -> Observations:
    """Corners and stripes of a capture by `jaxscan.calibrate` with a known rig, which is held.

    Args:
        calibration: File of the rig.
        capture: One of `held_out`.
    """
    scanner = jaxscan.load_scanner(calibration)
    known = jaxscan.KnownParts(camera=scanner.camera, sheets=(scanner.laser(0),), motion=scanner.turntable)
    settings = jaxscan.CalibrationSettings(judge=False)
    observations = jaxscan.calibrate(jaxscan.open_capture(capture), known=known, settings=settings).observations
    assert observations is not None
    return observations
