"""Layouts of the captures that other programs keep.

Horus keeps no images of a scan and FreeLSS none but a thumbnail, so there is nothing to recognise; pictures that were
saved by hand, as those in the notebooks of Horus' author, are recognised by the words in their names.
"""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from jaxscan.files.importing.listing import Matched


class ProgramCapture(NamedTuple):
    """A capture in the layout of a known program."""

    program: str
    on: dict[str, list[Matched]]
    """Laser-on images by the name of the laser."""
    off: list[Matched]
    step_deg: float | None
    """The table's angle between consecutive numbers, where the program fixes it."""
    said: str
    """How this layout is understood."""


def find_program(names: Sequence[str]) -> ProgramCapture | None:
    """The capture, if the names are those that a known program gives."""
    return _fabscan(names) or _thot(names)


def _fabscan(names: Sequence[str]) -> ProgramCapture | None:
    """FabScanPi with `keep_raw_images`: raw_laser_raw/<scan>_NNN.jpg and, from a turn before, color_raw/<scan>_NNN.jpg.

    It turns by 360 degrees over the number of pictures, and takes one laser picture more than that.
    """
    lit = _numbered(names, r"(?:.*/)?raw_laser_[^/]*/[^/]*_([0-9]+)\.jpe?g")
    if not lit:
        return None
    coloured = _numbered(names, r"(?:.*/)?color_[^/]*/[^/]*_([0-9]+)\.jpe?g")
    pictures = len(coloured) if coloured else len(lit) - 1
    step = 360.0 / pictures if pictures > 0 else None
    said = "the colour images come from another turn under other light, so they are no laser-off images"
    return ProgramCapture("FabScanPi", {"": lit}, [], step, said)


def _thot(names: Sequence[str]) -> ProgramCapture | None:
    """thot, a command line for the Ciclop: color_NNN.png, laser0_NNN.png and laser1_NNN.png, NNN in degrees."""
    lasers = {
        name: _numbered(names, rf"(?:.*/)?laser{number}_([0-9]{{3}})\.png")
        for name, number in (("left", 0), ("right", 1))
    }
    coloured = _numbered(names, r"(?:.*/)?color_([0-9]{3})\.png")
    if not any(lasers.values()):
        return None
    on = {name: found for name, found in lasers.items() if found}
    said = "the colour images were taken at the same angles with the lasers off"
    first = next(iter(on.values()))
    numbers = [int(image.key[0]) for image in first]
    step = math.gcd(*(number - numbers[0] for number in numbers)) or 1
    return ProgramCapture("thot", on if len(on) > 1 else {"": first}, coloured, float(step), said)


def _numbered(names: Sequence[str], expression: str) -> list[Matched]:
    found = [(name, re.fullmatch(expression, name, re.IGNORECASE)) for name in names]
    return [Matched(name, (int(hit[1]),)) for name, hit in found if hit and len(hit[1]) <= 18]
