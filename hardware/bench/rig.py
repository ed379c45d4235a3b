"""A rig without hardware: the real firmware in a simulated processor, on a serial port of its own."""

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.places import BenchError
from bench.processes import SIMRUN, Part, build


CLOCK_HZ = 16_000_000

READY_S = 10.0


@dataclass(frozen=True)
class RigOptions:
    """Settings of a simulated rig."""

    firmware: str | Path = "scan"
    """"scan", "scan_hang", "echo" (some other device, which sends back all bytes), or the path of an image."""
    speed: float = 1.0
    """Simulated seconds per second; 0: as fast as it goes."""
    microsteps_per_turn: int = 28800
    start: int = 500
    """Where the table stands at the beginning [microsteps]; the home switch closes at 0, from above."""
    home_width: int = 40
    """Microsteps over which the switch is closed, below 0."""
    bounce_us: int = 0
    """How long the switch chatters at each change."""
    autoreset: bool = False
    """Whether opening the port resets the processor, as on an Uno."""
    seed: int = 1
    apart: bool = False
    """Whether Ctrl-C at the terminal is kept from it."""

    def plant(self) -> list[str]:
        words = ["--microsteps-per-turn", str(self.microsteps_per_turn), "--home-width", str(self.home_width)]
        return [*words, "--bounce", str(self.bounce_us), *(["--autoreset"] if self.autoreset else [])]


RIG_DEFAULTS = RigOptions()


class SimulatedRig(Part):
    """Firmware, turntable, switches and laser, in a folder of their own: port, log, sockets, the EEPROM's content.

    Start it from a thread that lives as long as the rig: the kernel ends the runner with it.

    Tests assert on `edges()` and `plant()`, the pins and the table, not on the firmware's own words.
    """

    name, socket = "the simulator", "control"

    def __init__(self, folder: str | Path, options: RigOptions = RIG_DEFAULTS) -> None:
        super().__init__(folder)
        self.port = str(self.folder / "port")
        self.edges_path = self.folder / "edges.jsonl"
        self._options = options

    def start(self) -> None:
        """Switch on. After `kill` or `close` it goes on where it stood: position, EEPROM and log stay."""
        self._require_off()
        options = self._options
        image = build(options.firmware) if isinstance(options.firmware, str) else options.firmware
        if isinstance(options.firmware, Path):
            build("echo")
        self.folder.mkdir(parents=True, exist_ok=True)
        cycle, position = self._last()
        command = [str(SIMRUN), "--firmware", str(Path(image).resolve()), "--port", "port", "--edges", "edges.jsonl"]
        command += ["--control", self.socket, "--eeprom", "eeprom.bin", "--speed", str(options.speed)]
        command += ["--begin", str(cycle), "--start", str(position), "--seed", str(options.seed), *options.plant()]
        self._launch(command, within_s=READY_S, apart=options.apart)

    def control(self, text: str) -> str:
        """Give the runner one command, see README.md. Raises BenchError if it does not know it, or does not answer."""
        answer = self.ask(text)
        if answer.startswith("unknown"):
            raise BenchError(f"simrun does not know {text!r}.")
        return answer

    def plant(self) -> dict[str, Any]:
        """The true state of table, laser and line, now."""
        return dict(json.loads(self.control("state")))

    def edges(self) -> list[dict[str, Any]]:
        """The log so far: `cycle`, `pin`, `v`, `pos`; or `cycle`, `pos` and one of `host`, `reset`, `line`, `stop`."""
        if not self.edges_path.exists():
            return []
        if self._process is not None:
            self.plant()  # Its answer comes after all earlier events are in the log.
        lines = self.edges_path.read_text().split("\n")
        return [json.loads(line) for line in lines[:-1]]

    def run_for(self, seconds: float, *, timeout_s: float = 60.0) -> None:
        """Wait until so much simulated time has passed. Raises BenchError if it does not pass."""
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
        self.control("plug")

    def kill(self) -> None:
        self.close(kill=True)

    def restart(self) -> None:
        self.kill()
        self.start()

    def close(self, *, kill: bool = False) -> None:
        if self._process is not None:
            super().close(kill=kill)
            Path(self.port).unlink(missing_ok=True)

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
