"""The pages of the project, and what stands between fences in them."""

import re
from pathlib import Path
from typing import NamedTuple


ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("docs", "hardware", "experiments")
_FENCE = re.compile(r"^ *```(\w*)[^\n]*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)


class Fence(NamedTuple):
    """A block of code on a page."""

    page: Path
    line: int
    """Where it begins."""
    language: str
    """What stands behind the three backticks; "" for commands and outputs."""
    text: str


def pages():
    """Every page: those of the root, and those of the rooms."""
    below = [page for room in ROOMS for page in (ROOT / room).rglob("*.md") if "build" not in page.parts]
    return sorted([*ROOT.glob("*.md"), *below])


def fences(page):
    """The fences of a page, in order."""
    text = page.read_text()
    return [Fence(page, 1 + text.count("\n", 0, found.start()), found[1], found[2]) for found in _FENCE.finditer(text)]


def name_of(page):
    """A page's place in the repository."""
    return page.relative_to(ROOT).as_posix()


def prose(page):
    """A page without its fences."""
    return _FENCE.sub("", page.read_text())
