"""A rig without hardware: the real firmware in a simulated processor, on a serial port of its own."""

import contextlib
import json
import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from bench.places import BenchError
from bench.processes import SIMRUN, ControlClient, build, end, epitaph, launch


CLOCK_HZ = 16_000_000
"""Cycles per second of the log's stamps."""

READY_S = 10.0
"""How long the runner may take to start, on a busy machine."""


@dataclass(frozen=True)
class RigOptions:
    """Settings of a simulated rig."""

    firmware: str | Path = "scan"
    """"scan", "scan_hang", "echo" (some other device, which sends back all bytes), or the path of an image."""
    speed: float = 1.0
    """Simulated seconds per second; 0: as fast as it goes."""
    microsteps_per_turn: int = 28800
    """Of the plant: the angle is position / this."""
    start: int = 500
    """Where the table stands at the beginning [microsteps]; the home switch closes at 0, from above."""
    home_width: int = 40
    """Microsteps over which the switch is closed, below 0."""
    bounce_us: int = 0
    """How long the switch chatters at each change."""
    autoreset: bool = False
    """Whether opening the port resets the processor, as on an Uno."""
    seed: int = 1
    """Of the noise on the line."""
    apart: bool = False
    """Whether Ctrl-C at the terminal is kept from it."""

    def plant(self) -> list[str]:
        """The words by which the runner is told of the plant."""
        words = ["--microsteps-per-turn", str(self.microsteps_per_turn), "--home-width", str(self.home_width)]
        return [*words, "--bounce", str(self.bounce_us), *(["--autoreset"] if self.autoreset else [])]


RIG_DEFAULTS = RigOptions()


class SimulatedRig:
    """Firmware, turntable, switches and laser, in a folder of their own.

    Start it from a thread that lives as long as the rig: the kernel ends the runner with it.

    Tests assert on `edges()` and `plant()`, the pins and the table, not on the firmware's own words.
    """

    def __init__(self, folder: str | Path, options: RigOptions = RIG_DEFAULTS) -> None:
        """A rig that `start` (or `with`) switches on.

        Args:
            folder: Holds port, log, sockets and the EEPROM's content; made if it is not there.
        """
        self.folder = Path(folder)
        self.port = str(self.folder / "port")
        self.edges_path = self.folder / "edges.jsonl"
        self.control_path = self.folder / "control"
        self._options = options
        self._process: subprocess.Popen[str] | None = None
        self._control: ControlClient | None = None

    def __enter__(self) -> "SimulatedRig":
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self) -> None:
        """Switch on. After `kill` or `close` it goes on where it stood: position, EEPROM and log stay.

        Raises:
            BenchError: If the build fails or the runner does not come up.
        """
        if self._process is not None:
            raise BenchError(f"{self.folder}: this rig is on already.")
        options = self._options
        image = build(options.firmware) if isinstance(options.firmware, str) else options.firmware
        if isinstance(options.firmware, Path):
            build("echo")
        self.folder.mkdir(parents=True, exist_ok=True)
        cycle, position = self._last()
        command = [str(SIMRUN), "--firmware", str(Path(image).resolve()), "--port", "port", "--edges", "edges.jsonl"]
        command += ["--control", "control", "--eeprom", "eeprom.bin", "--speed", str(options.speed)]
        command += ["--begin", str(cycle), "--start", str(position), "--seed", str(options.seed), *options.plant()]
        errors = self.folder / "simrun.err"
        self._process = launch(command, folder=self.folder, errors=errors, within_s=READY_S, apart=options.apart)
        self._control = ControlClient(self.control_path)

    def control(self, text: str) -> str:
        """Give the runner one command, see README.md.

        Raises:
            BenchError: If it does not know it, or does not answer.
        """
        if self._control is None:
            raise BenchError(f"{self.folder}: this rig is off.")
        answer = self._control.ask(text)
        if answer.startswith("unknown"):
            raise BenchError(f"simrun does not know {text!r}.")
        return answer

    def plant(self) -> dict[str, Any]:
        """The true state of table, laser and line, now."""
        return dict(json.loads(self.control("state")))

    def died(self) -> str:
        """How the runner ended by itself, "" if it runs or was switched off."""
        return epitaph("the simulator", self._process, self.folder / "simrun.err")

    def edges(self) -> list[dict[str, Any]]:
        """The log so far: `cycle`, `pin`, `v`, `pos`; or `cycle`, `pos` and one of `host`, `reset`, `line`, `stop`."""
        if not self.edges_path.exists():
            return []
        if self._control is not None:
            self.plant()  # Its answer comes after all earlier events are in the log.
        lines = self.edges_path.read_text().split("\n")
        return [json.loads(line) for line in lines[:-1]]

    def run_for(self, seconds: float, *, timeout_s: float = 60.0) -> None:
        """Wait until so much simulated time has passed.

        Raises:
            BenchError: If it does not pass.
        """
        goal = self.plant()["cycle"] + int(seconds * CLOCK_HZ)
        end = time.monotonic() + timeout_s
        while self.plant()["cycle"] < goal:
            if time.monotonic() > end:
                raise BenchError(f"{self.folder}: {seconds} simulated seconds took more than {timeout_s} s.")
            time.sleep(0.001)

    def unplug(self) -> None:
        """Pull the cable: the port goes away; the processor runs on."""
        self.control("unplug")

    def plug(self) -> None:
        """Plug it in again."""
        self.control("plug")

    def kill(self) -> None:
        """Take the power away, in the middle of any action."""
        self._end(kill=True)

    def restart(self) -> None:
        """Power off and on again."""
        self.kill()
        self.start()

    def close(self) -> None:
        """Switch off. Doing so twice is doing it once."""
        self._end(kill=False)

    def _end(self, *, kill: bool) -> None:
        process, self._process = self._process, None
        control, self._control = self._control, None
        if control is not None:
            control.close()
        if process is None:
            return
        end(process, kill=kill)
        for left in (Path(self.port), self.control_path):
            with contextlib.suppress(FileNotFoundError):
                left.unlink()

    def _last(self) -> tuple[int, int]:
        """Cycle and position at the end of the log, where a rig that was on before goes on."""
        if not self.edges_path.exists():
            return 0, self._options.start
        *lines, torn = self.edges_path.read_bytes().split(b"\n")
        if torn:
            # Killed within a line. Nothing may be written after half of one.
            os.truncate(self.edges_path, self.edges_path.stat().st_size - len(torn))
        if not lines:
            return 0, self._options.start
        last = json.loads(lines[-1])
        return last["cycle"], last["pos"]
