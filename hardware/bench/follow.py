"""Follows a rig's log: what the plant did, and each exposure that its trigger wire asked for."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple


class Exposure(NamedTuple):
    """One pulse of the trigger wire, and what the plant showed meanwhile."""

    cycle: int
    """When it began."""
    position: int
    """Microsteps from where the home switch closed last, on the way down."""
    light: float
    """Share of the pulse during which the laser shone."""


class LogReader:
    """Complete lines of a log that grows, or that was cut back to its last complete line."""

    def __init__(self, path: Path) -> None:
        """Begin at the start of the file, which need not exist yet."""
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
class Plant:
    """The plant as far as the log was read."""

    microsteps_per_turn: int
    position: int = 0
    home: int = 0
    """Position of the switch's edge when it closed last, on the way down."""
    light: bool = False
    down: bool = False
    trigger_since: int | None = None
    """Cycle at which the trigger rose; None while it is low."""
    began_at: int = 0
    """Position from home at that moment."""
    lit_cycles: int = 0
    lit_since: int | None = None

    def read(self, line: dict[str, Any]) -> tuple[bool, Exposure | None]:
        """Take one line in.

        Returns:
            Whether the trigger rises here, and the exposure that ends here, if one does.
        """
        self.position = line["pos"]
        pin, cycle = line.get("pin"), line["cycle"]
        if pin == "dir":
            self.down = bool(line["v"])
        elif pin == "home_n" and not line["v"] and self.down and self.position % self.microsteps_per_turn == 0:
            self.home = self.position
        elif pin == "light":
            self._switch(bool(line["v"]), cycle)
        elif pin == "trig":
            return self._trigger(bool(line["v"]), cycle)
        return False, None

    def from_home(self) -> int:
        """Microsteps from home."""
        return self.position - self.home

    def _switch(self, on: bool, cycle: int) -> None:
        if self.light and not on and self.lit_since is not None:
            self.lit_cycles += cycle - self.lit_since
        self.lit_since = cycle if on else None
        self.light = on

    def _trigger(self, on: bool, cycle: int) -> tuple[bool, Exposure | None]:
        if on:
            self.trigger_since, self.began_at, self.lit_cycles = cycle, self.from_home(), 0
            self.lit_since = cycle if self.light else None
            return True, None
        if self.trigger_since is None:
            return False, None
        lit = self.lit_cycles + (cycle - self.lit_since if self.lit_since is not None else 0)
        ended = Exposure(self.trigger_since, self.began_at, lit / max(cycle - self.trigger_since, 1))
        self.trigger_since = None
        return False, ended
