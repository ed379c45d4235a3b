"""Parses a line of G-code as GRBL does, with the words that turn an axis X and switch a spindle."""

import re
from dataclasses import dataclass


_WORD = re.compile(r"([A-Z])(-?\d*\.?\d+)")
_CODES = {"G0", "G1", "G4", "G21", "G53", "G90", "G94", "M3", "M5"}
_VALUES = set("XFSP")


@dataclass(frozen=True)
class Block:
    """A parsed line."""

    motion: str
    """G0 or G1, which stays for the lines after it."""
    feed: float
    power: float | None
    spindle: str | None
    """M3 or M5."""
    target: float | None
    """Where the axis is to go."""
    waits: bool
    """Whether it is carried out only when all motions before it are over."""


def parse(text: str, *, motion: str, feed: float) -> Block | str:
    """A line without spaces, in capitals.

    Args:
        motion: G0 or G1, as it was.

    Returns:
        The parsed line, or GRBL's answer to a line that it does not understand.
    """
    words = _WORD.findall(text)
    if "".join(letter + number for letter, number in words) != text:
        return "error:2" if text[0].isalpha() else "error:1"
    codes = [f"{letter}{float(number):g}" for letter, number in words if letter in "GM"]
    values = {letter: float(number) for letter, number in words if letter not in "GM"}
    if not set(codes) <= _CODES or not set(values) <= _VALUES:
        return "error:20"
    motion = next((code for code in codes if code in ("G0", "G1")), motion)
    feed = values.get("F", feed)
    if "X" in values and motion == "G1" and feed <= 0:
        return "error:22"
    spindle = next((code for code in codes if code in ("M3", "M5")), None)
    waits = spindle is not None or "G4" in codes
    return Block(motion, feed, values.get("S"), spindle, values.get("X"), waits)
