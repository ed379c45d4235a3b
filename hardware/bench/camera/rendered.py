"""The camera of the bench: a furnished room with a laser and a board, seen at each trigger in the log of the rig."""

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from bench.places import WORLD, BenchError, held, private_folder
from bench.processes import Part
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

_PLAN, _NOISE = 2, 7
"""Streams of random numbers that are drawn from the world's seed."""


class View(NamedTuple):
    """The scene in front of the lens during an exposure."""

    angle: float
    """The table's true count of its angle, before the world's gain and harmonics [rad]."""
    lights: tuple[float, ...] = (0.0,)
    """Share of the exposure during which each laser shone, in the order of the world's file."""
    board: int | None = None
    exposure: float = 1.0
    """Exposure time and gain, as a factor on the nominal."""


class World:
    """Renders views; the last expectation is kept, since laser-on and laser-off frames of a step share it."""

    def __init__(self, config: SimulationConfig, *, reach_deg: float = 0.0) -> None:
        """A world from a simulation's configuration.

        Args:
            reach_deg: Only placements are kept from which the board is seen over at least this angle to both sides.
        """
        self.config = config
        self._config_of = {
            bits: config.model_copy(update={"sensor": config.sensor.model_copy(update={"bits": bits})})
            for bits in (8, 16)
        }
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
        """A pose of the board, as its holder knows it: free view or placement, and the angles that see it."""
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

    def frame(
        self, view: View, number: int, *, flash_dn: float = 0.0, blur_px: int = 0, bits: Literal[8, 16] = 8
    ) -> np.ndarray:
        """One frame, uint8 [rows, columns]; uint16 of 16 bits.

        Args:
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
        return take_frame(light, self._config_of[bits], rng)

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
    """A world from a file that a simulation is described by, mono8. Raises ConfigError or BenchError."""
    config = load_toml(path, SimulationConfig)
    if config.sensor.pixel_format != "mono8":
        raise BenchError(f"{path}: the camera on loopback is mono8, found {config.sensor.pixel_format}.")
    return World(config, reach_deg=reach_deg)


class Exposure(NamedTuple):
    """One pulse of the trigger wire, with table and lasers during it."""

    cycle: int
    position: int
    """Microsteps from where the home switch closed last, on the way down."""
    light: float
    """Share of the pulse during which the first laser shone."""
    light_2: float = 0.0
    """Share of the pulse during which the second laser shone."""


class LogReader:
    """Complete lines of a log that grows, or that was cut back to its last complete line."""

    def __init__(self, path: Path) -> None:
        self._path, self._read = path, 0

    def lines(self) -> list[dict[str, Any]]:
        """The objects that were written since the last call."""
        if not self._path.exists():
            return []
        with open(self._path, "rb") as file:
            file.seek(self._read)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._read += len(whole)
        return [json.loads(line) for line in whole.splitlines()]


@dataclass
class Light:
    """One laser's light, and for how much of a trigger pulse it shone."""

    on: bool = False
    cycles: int = 0
    """Cycles of this pulse for which it shone, up to when it last went off."""
    since: int | None = None

    def switch(self, on: bool, cycle: int) -> None:
        if self.on and not on and self.since is not None:
            self.cycles += cycle - self.since
        self.since = cycle if on else None
        self.on = on

    def begin(self, cycle: int) -> None:
        self.cycles, self.since = 0, cycle if self.on else None

    def share(self, began: int, cycle: int) -> float:
        """The part of the pulse from `began` to `cycle` during which it shone."""
        lit = self.cycles + (cycle - self.since if self.since is not None else 0)
        return lit / max(cycle - began, 1)


@dataclass
class Plant:
    """The plant as far as the log was read."""

    microsteps_per_turn: int
    position: int = 0
    home: int = 0
    """Position of the switch's edge when it closed last, on the way down."""
    lights: dict[str, Light] = field(default_factory=lambda: {"light": Light(), "light_2": Light()})
    down: bool = False
    trigger_since: int | None = None
    """Cycle at which the trigger rose; None while it is low."""
    began_at: int = 0
    """Position from home at that moment."""

    def read(self, line: dict[str, Any]) -> tuple[bool, Exposure | None]:
        """Take one line in; returns whether the trigger rises here, and the exposure that ends here, if one does."""
        self.position = line["pos"]
        pin, cycle = line.get("pin"), line["cycle"]
        if pin == "dir":
            self.down = bool(line["v"])
        elif pin == "home_n" and not line["v"] and self.down and self.position % self.microsteps_per_turn == 0:
            self.home = self.position
        elif pin in self.lights:
            self.lights[pin].switch(bool(line["v"]), cycle)
        elif pin == "trig":
            return self._trigger(bool(line["v"]), cycle)
        return False, None

    def from_home(self) -> int:
        return self.position - self.home

    def _trigger(self, on: bool, cycle: int) -> tuple[bool, Exposure | None]:
        if on:
            self.trigger_since, self.began_at = cycle, self.from_home()
            for light in self.lights.values():
                light.begin(cycle)
            return True, None
        if self.trigger_since is None:
            return False, None
        shares = (light.share(self.trigger_since, cycle) for light in self.lights.values())
        ended = Exposure(self.trigger_since, self.began_at, *shares)
        self.trigger_since = None
        return False, ended


ADDRESS = "127.0.0.1"
READY_S = 90.0


class RenderedCamera(Part):
    """A GigE Vision camera at 127.0.0.1 that sees the plant of a simulated rig."""

    name, socket = "the camera", "camera"

    def __init__(
        self,
        folder: str | Path,
        *,
        edges: Path,
        world: Path = WORLD,
        microsteps_per_turn: int = 28800,
        apart: bool = False,
    ) -> None:
        """A camera that is off, in front of a rig by its log."""
        super().__init__(folder)
        self.edges, self.world, self.address = edges, world, ADDRESS
        self.ledger = self.folder / "frames.jsonl"
        self._microsteps_per_turn, self._apart = microsteps_per_turn, apart

    def start(self) -> None:
        self._require_off()
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = {"edges": self.edges, "world": self.world, "control": self.control_path, "ledger": self.ledger}
        command = [sys.executable, "-m", "bench.camera", "--address", self.address, "--owner", str(os.getpid())]
        command += ["--microsteps-per-turn", str(self._microsteps_per_turn)]
        for name, path in paths.items():
            command += [f"--{name}", str(path.resolve())]
        self._launch(command, within_s=READY_S, apart=self._apart)

    def control(self, text: str) -> Any:
        """Give the camera one command (see README.md), and return its answer, parsed if it is JSON."""
        answer = self.ask(text)
        if answer.startswith("error: "):
            raise BenchError(answer.removeprefix("error: "))
        return answer if answer == "ok" else json.loads(answer)

    def frames(self) -> list[dict[str, Any]]:
        """The truth of every frame so far: `cycle`, `position`, `light`, `angle` [rad], `board`, `exposure`, `sent`."""
        if not self.ledger.exists():
            return []
        return [json.loads(line) for line in self.ledger.read_text().split("\n")[:-1]]

    def settle(self, *, timeout_s: float = 60.0) -> None:
        """Wait until something has become of every trigger pulse that is in the log now. Raises BenchError."""
        text = self.edges.read_text() if self.edges.exists() else ""
        # The pin is low from the beginning, which the log says first.
        pulses = max(text.count('"pin":"trig","v":0') - 1, 0)
        limit = time.monotonic() + timeout_s
        while True:
            state = self.control("state")
            done = sum(state[name] for name in ("not_armed", "lost", "sent", "refused"))
            if state["triggers"] >= pulses and done == state["triggers"]:
                return
            if time.monotonic() > limit:
                raise BenchError(f"{self.folder}: {pulses} pulses, of which the camera is done with {done}.")
            time.sleep(0.01)


@contextmanager
def loopback(*, timeout_s: float = 240.0) -> Iterator[None]:
    """Holds the one address at which a GigE Vision camera can be: port 3956 of 127.0.0.1."""
    path = private_folder() / "loopback.lock"
    busy = (
        f"{ADDRESS} is taken: another bench, or a test with a camera, runs on this machine ({path} is locked); "
        "wait until it has ended."
    )
    with held(path, timeout_s=timeout_s, busy=busy):
        yield
