"""The world in front of the bench's camera: a furnished room, a laser, and a board in a person's hands."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.errors import BenchError
from bench.places import WORLD
from jaxscan.files.disk import load_toml
from jaxscan.simulation import (
    ExpectedRecord,
    Placement,
    SeenBoard,
    SimulationConfig,
    expect_record,
    make_print,
    make_rig,
    make_scene,
    plan_boards,
    speckled,
    take_frame,
)
from jaxscan.vision import board_texture


NOMINAL_EXPOSURE_S = 0.01
"""Exposure time at which the world is as bright as its file says."""

TEXTURE_PX = 60
"""Pixels per square of the picture from which boards are rendered."""

_PLAN, _NOISE = 2, 7
"""Streams of random numbers that are drawn from the world's seed."""


class View(NamedTuple):
    """The scene in front of the lens during an exposure."""

    angle: float
    """The table's true count of its angle, before the world's gain and harmonics [rad]."""
    lights: tuple[float, ...] = (0.0,)
    """Share of the exposure during which each laser shone, in the order of the world's file."""
    board: int | None = None
    """Number of the board's pose; None: no board."""
    exposure: float = 1.0
    """Exposure time and gain, as a factor on the nominal."""


class World:
    """Renders views; the last expectation is kept, since laser-on and laser-off frames of a step share it."""

    def __init__(self, config: SimulationConfig, *, reach_deg: float = 0.0) -> None:
        """A world from a simulation's configuration.

        Args:
            config: The rig, its room and its boards.
            reach_deg: Only placements are kept from which the board is seen over at least this angle to both sides.
        """
        self.config = config
        self.reach_deg = reach_deg
        self._rig, self._scene = make_rig(config), make_scene(config)
        self._boards = make_scene(config, boards=config.object is not None)
        self._print = make_print(config.boards, board_texture(config.boards.board(), TEXTURE_PX))
        self._poses: list[Placement] | None = None
        self._last: tuple[tuple[float, int | None], dict[int, ExpectedRecord]] | None = None

    def poses(self) -> list[Placement]:
        """The board's poses, in order: free views at angle 0, then placements."""
        if self._poses is None:
            wanted = self.config.boards
            plan = plan_boards(self._with_spare(), self._boards, self._generator(_PLAN, 0))
            reach = np.deg2rad(self.reach_deg)
            wide = [p for p in plan if p.number is not None and p.angles[0] <= -reach and p.angles[-1] >= reach]
            if len(wide) < wanted.placements:
                raise BenchError(
                    f"Only {len(wide)} of {wanted.placements} placements of the board are seen over "
                    f"{self.reach_deg}° to both sides: take a smaller board, or fewer degrees."
                )
            free = [p for p in plan if p.number is None]
            self._poses = free + [p._replace(number=k) for k, p in enumerate(wide[: wanted.placements])]
        return self._poses

    def describe(self, board: int) -> dict[str, Any]:
        """A pose of the board, as its holder knows it: free view or placement, and the angles that see it.

        Raises:
            BenchError: If there is no such pose.
        """
        poses = self.poses()
        if not 0 <= board < len(poses):
            raise BenchError(f"There is no pose {board} of the board: 0 … {len(poses) - 1}.")
        pose = poses[board]
        angles = [round(float(np.rad2deg(angle)), 2) for angle in pose.angles]
        kind = "free" if pose.number is None else "placement"
        return {"board": board, "kind": kind, "placement": pose.number, "angles_deg": angles, "poses": len(poses)}

    def expect(self, angle: float, board: int | None = None, laser: int = 0) -> ExpectedRecord:
        """Room light, and the light of one laser, at an angle [rad], without noise."""
        if self._last is None or self._last[0] != (angle, board):
            self._last = ((angle, board), {})
        known = self._last[1]
        if laser not in known:
            seen = None
            if board is not None:
                pose = self.poses()[board]
                seen = SeenBoard(self._print, pose.scanner_from_board.inverse() @ self._rig.pose(angle))
            scene = self._scene if board is None else self._boards
            known[laser] = expect_record(self._rig, scene, angle, laser=laser, board=seen)
        return known[laser]

    def frame(self, view: View, number: int, *, flash_dn: float = 0.0, blur_px: int = 0) -> np.ndarray:
        """One frame, uint8 [rows, columns].

        Args:
            view: The scene in front of the lens.
            number: Chooses the noise: the same view and number give the same frame.
            flash_dn: Light that is added everywhere, as by a flash or an opened door.
            blur_px: How far the image moves during the exposure, along the rows.
        """
        rng = self._generator(_NOISE, number)
        lit = [(laser, share) for laser, share in enumerate(view.lights[: len(self.config.laser)]) if share > 0]
        # Without a laser's light any record will do, and there is one already.
        light = self.expect(view.angle, view.board, lit[0][0] if lit else self._known_laser()).off
        for laser, share in lit:
            record = self.expect(view.angle, view.board, laser)
            light = light + np.float32(share) * speckled(record, self.config, rng)
        light = light * np.float32(view.exposure) + np.float32(flash_dn)
        if blur_px:
            light = np.stack([np.roll(light, shift, axis=1) for shift in range(blur_px + 1)]).mean(0)
        return take_frame(light, self.config, rng)

    def _known_laser(self) -> int:
        """The laser whose record was made last; the room looks the same in all."""
        return next(reversed(self._last[1]), 0) if self._last is not None else 0

    def _with_spare(self) -> Any:
        """The rig with more placements than are wanted, to choose the wide ones from."""
        spare = 8 * self.config.boards.placements if self.reach_deg > 0 else self.config.boards.placements
        boards = self.config.boards.model_copy(update={"placements": spare})
        return make_rig(self.config.model_copy(update={"boards": boards}))

    def _generator(self, stream: int, number: int) -> np.random.Generator:
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence([self.config.seed, stream, number])))


def load_world(path: Path = WORLD, *, reach_deg: float = 0.0) -> World:
    """A world from a file that a simulation is described by, mono8.

    Raises:
        ConfigError: With the key that is unknown, missing or wrong.
        BenchError: If it is not a monochrome one.
    """
    config = load_toml(path, SimulationConfig)
    if config.sensor.pixel_format != "mono8":
        raise BenchError(f"{path}: the camera on loopback is mono8, found {config.sensor.pixel_format}.")
    return World(config, reach_deg=reach_deg)
