"""Orders of a page: JSON messages, of which only those that are listed mean something."""

import json
import re
from typing import Any, NamedTuple

from jaxscan.errors import JaxscanError


class BadOrder(JaxscanError):
    """A message that is no order."""


NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
MOST_BYTES = 4096
FOR_ALL = {"stop", "take over"}
"""Orders of a page that watches: everybody may switch the laser off."""
_RANGES = {"deg": (-3600.0, 3600.0), "exposure_ms": (0.001, 10_000.0), "gain_db": (-100.0, 100.0)}
_FLAGS = {"resume", "stop", "on"}
_FIELDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("stop", "take over", "pause", "aim", "take", "enough", "enough of all", "auto"), ()),
    **dict.fromkeys(("sweep", "boards"), ("name", "resume")),
    **dict.fromkeys(("calibrate", "recalibrate", "reconstruct", "plan", "mesh", "report", "use", "delete"), ("name",)),
    **dict.fromkeys(("compare", "rename"), ("name", "other")),
    "lost": ("stop",),
    "jog": ("deg",),
    "light": ("on",),
    "expose": ("exposure_ms", "gain_db"),
}
"""Orders, and the fields of each: a range for a number, a type for a flag; the others are names."""


class Order(NamedTuple):
    """An order that is understood."""

    do: str
    name: str = ""
    other: str = ""
    resume: bool = False
    stop: bool = False
    on: bool = False
    deg: float = 0.0
    """Where the table is to point."""
    exposure_ms: float = 0.0
    gain_db: float = 0.0


def parse_order(text: str) -> Order:
    """Read a message of a page.

    Raises:
        BadOrder: If it is none.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise BadOrder("a message that is no JSON.") from problem
    do = found.get("do") if isinstance(found, dict) else None
    wanted = _FIELDS.get(do) if isinstance(do, str) else None
    if not isinstance(do, str) or wanted is None or set(found) != {"do", *wanted}:
        raise BadOrder("an order that is not known; load the page again.")
    return Order(do, **{name: _field(name, found[name]) for name in wanted})


def _field(name: str, value: Any) -> Any:
    if name in _RANGES:
        low, high = _RANGES[name]
        # NaN is in no range; Python compares integers of any length.
        if isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high:
            return float(value)
        raise BadOrder(f"{name}: expected a number of {low:g} to {high:g}.")
    if name in _FLAGS:
        if isinstance(value, bool):
            return value
        raise BadOrder(f"{name}: expected true or false.")
    if isinstance(value, str) and is_name(value):
        return value
    raise BadOrder(f"{name}: {NAME_WORDS}")


NAME_WORDS = "expected letters, digits, dots, dashes and underscores, 64 at most."


def is_name(text: str) -> bool:
    """Whether a capture may be called so: no path, and nothing that a command takes for an option."""
    return NAME.fullmatch(text) is not None and ".." not in text
