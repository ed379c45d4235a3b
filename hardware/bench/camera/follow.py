"""Follows a rig's log: the state of the plant, and each exposure that its trigger wire asked for."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple


class Exposure(NamedTuple):
    """One pulse of the trigger wire, with table and lasers during it."""

    cycle: int
    """When it began."""
    position: int
    """Microsteps from where the home switch closed last, on the way down."""
    light: float
    """Share of the pulse during which the first laser shone."""
    light_2: float = 0.0
    """Share of the pulse during which the second laser shone."""


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
class Light:
    """One laser's light, and for how much of a trigger pulse it shone."""

    on: bool = False
    cycles: int = 0
    """Of this pulse, up to when it went off last."""
    since: int | None = None

    def switch(self, on: bool, cycle: int) -> None:
        """It goes on or off."""
        if self.on and not on and self.since is not None:
            self.cycles += cycle - self.since
        self.since = cycle if on else None
        self.on = on

    def begin(self, cycle: int) -> None:
        """A pulse begins."""
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
    """By their names in the log."""
    down: bool = False
    trigger_since: int | None = None
    """Cycle at which the trigger rose; None while it is low."""
    began_at: int = 0
    """Position from home at that moment."""

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
        elif pin in self.lights:
            self.lights[pin].switch(bool(line["v"]), cycle)
        elif pin == "trig":
            return self._trigger(bool(line["v"]), cycle)
        return False, None

    def from_home(self) -> int:
        """Microsteps from home."""
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
