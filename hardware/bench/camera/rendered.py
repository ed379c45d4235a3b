"""Starts the camera on the bench in a process of its own, and talks to it."""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from bench.errors import BenchError
from bench.locks import held, private_folder
from bench.places import WORLD
from bench.processes import end, epitaph, launch
from bench.sockets import ControlClient


ADDRESS = "127.0.0.1"
READY_S = 90.0
"""How long the camera may take to start: it loads the simulator and makes a room, perhaps on a busy machine."""


class RenderedCamera:
    """A GigE Vision camera at 127.0.0.1 that sees the plant of a simulated rig."""

    def __init__(
        self,
        folder: str | Path,
        *,
        edges: Path,
        world: Path = WORLD,
        microsteps_per_turn: int = 28800,
        apart: bool = False,
    ) -> None:
        """A camera that `start` (or `with`) switches on.

        Args:
            folder: Holds its control socket and its ledger; made if it is not there.
            world: The world in front of it, a simulated rig.
            apart: Whether Ctrl-C at the terminal is kept from it.
        """
        self.folder, self.edges, self.world, self.address = Path(folder), edges, world, ADDRESS
        self.ledger = self.folder / "frames.jsonl"
        self._microsteps_per_turn, self._apart = microsteps_per_turn, apart
        self._process: subprocess.Popen[str] | None = None
        self._control: ControlClient | None = None

    def __enter__(self) -> "RenderedCamera":
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self) -> None:
        """Switch on.

        Raises:
            BenchError: If libaravis is missing, the address is taken, or the world cannot be rendered.
        """
        if self._process is not None:
            raise BenchError(f"{self.folder}: this camera is on already.")
        self.folder.mkdir(parents=True, exist_ok=True)
        folder = self.folder.resolve()
        command = [sys.executable, "-m", "bench.camera", "--edges", str(self.edges.resolve()), "--world"]
        command += [
            str(self.world.resolve()),
            "--control",
            str(folder / "camera"),
            "--ledger",
            str(self.ledger.resolve()),
        ]
        command += ["--microsteps-per-turn", str(self._microsteps_per_turn), "--address", self.address]
        command += ["--owner", str(os.getpid())]
        self._process = launch(
            command, folder=folder, errors=folder / "camera.err", within_s=READY_S, apart=self._apart
        )
        self._control = ControlClient(folder / "camera")

    def control(self, text: str) -> Any:
        """Give the camera one command (see README.md), and return its answer, parsed if it is JSON.

        Raises:
            BenchError: If it does not know it, or does not answer.
        """
        if self._control is None:
            raise BenchError(f"{self.folder}: this camera is off.")
        answer = self._control.ask(text)
        if answer.startswith("error: "):
            raise BenchError(answer.removeprefix("error: "))
        return answer if answer == "ok" else json.loads(answer)

    def died(self) -> str:
        """How its process ended by itself, "" if it runs or was switched off."""
        return epitaph("the camera", self._process, self.folder / "camera.err")

    def frames(self) -> list[dict[str, Any]]:
        """The truth of every frame so far: `cycle`, `position`, `light`, `angle` [rad], `board`, `exposure`, `sent`."""
        if not self.ledger.exists():
            return []
        return [json.loads(line) for line in self.ledger.read_text().split("\n")[:-1]]

    def settle(self, *, timeout_s: float = 60.0) -> None:
        """Wait until something has become of every trigger pulse that is in the log now.

        Raises:
            BenchError: If that takes too long.
        """
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

    def close(self) -> None:
        """Switch off. Doing so twice is doing it once."""
        process, self._process = self._process, None
        control, self._control = self._control, None
        if control is not None:
            control.close()
        if process is not None:
            end(process)
            # One that was killed left its socket.
            with contextlib.suppress(FileNotFoundError):
                (self.folder / "camera").unlink()


@contextmanager
def loopback(*, timeout_s: float = 240.0) -> Iterator[None]:
    """Holds the one address at which a GigE Vision camera can be: port 3956 of 127.0.0.1.

    Raises:
        BenchError: If another process keeps it too long.
    """
    path = private_folder() / "loopback.lock"
    busy = (
        f"{ADDRESS} is taken: another bench, or a test with a camera, runs on this machine ({path} is locked); "
        "wait until it has ended."
    )
    with held(path, timeout_s=timeout_s, busy=busy):
        yield
