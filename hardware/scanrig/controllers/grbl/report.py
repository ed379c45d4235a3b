"""Reads the lines of a GRBL board: state reports, alarms, settings."""

import re
from dataclasses import dataclass

from scanrig.controllers.status import State


STATES: dict[str, State] = {
    "Idle": "idle",
    "Check": "idle",
    "Run": "move",
    "Jog": "move",
    "Hold": "move",
    "Home": "home",
    "Alarm": "fault",
    "Door": "fault",
    "Sleep": "fault",
    "Tool": "fault",
}
"""GRBL's states as a session's. "Alarm" without a number, as after power on, only means that home is not known."""

_REPORT = re.compile(r"<([A-Z][a-z]+)(?::([0-9]{1,3}))?((?:\|[A-Za-z]+:[^|<>]*)*)>")
_NUMBER = re.compile(r"-?[0-9]{1,9}(?:\.[0-9]{0,9})?")
_SETTING = re.compile(rf"\$([0-9]{{1,3}})=({_NUMBER.pattern})")
_AXES = "XYZABC"


@dataclass(frozen=True)
class Report:
    """The answer to `?`."""

    state: str
    """Idle, Run, Hold, Jog, Home, Alarm, Door, Check, Sleep or Tool."""
    part: int
    """The number after the state: Hold:0 stands still, Hold:1 slows down, Alarm:10 is that alarm; 0 if there is none.
    """
    positions: tuple[float, ...] | None
    """Machine coordinates of the axes; None if the board reports others ($10)."""

    @property
    def moving(self) -> bool:
        """Whether the table turns."""
        return self.state in ("Run", "Jog", "Home") or (self.state == "Hold" and self.part != 0)

    def position(self, axis: str) -> float | None:
        """Coordinate of one axis; None if it is not reported."""
        at = _AXES.index(axis)
        return None if self.positions is None or at >= len(self.positions) else self.positions[at]


def read_report(line: str) -> Report | None:
    """The state report in a line; None if it is no report, or damaged."""
    match = _REPORT.fullmatch(line)
    if match is None or match[1] not in STATES:
        return None
    fields = dict(field.split(":", 1) for field in match[3].split("|")[1:])
    words = fields["MPos"].split(",") if "MPos" in fields else []
    if not all(map(_NUMBER.fullmatch, words)):
        return None
    return Report(match[1], int(match[2] or 0), tuple(map(float, words)) if words else None)


def read_settings(lines: list[str]) -> dict[int, float]:
    """The settings among the lines of the answer to `$$`."""
    return {int(match[1]): float(match[2]) for line in lines if (match := _SETTING.fullmatch(line))}
