"""Orders of a page: JSON messages, of which only those that are listed mean something."""

import json
import re
from typing import Any, NamedTuple

from jaxscan.errors import JaxscanError


class BadOrder(JaxscanError):
    """A message that is no order."""


class Range(NamedTuple):
    """Numbers that a field may have."""

    low: float
    high: float


NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
"""Names of captures and clouds."""
MOST_BYTES = 4096
"""Longest message of a page."""
FOR_ALL = {"stop", "take over"}
"""Orders of a page that watches: everybody may switch the laser off."""
_FIELDS: dict[str, dict[str, Any]] = {
    "stop": {},
    "take over": {},
    "pause": {},
    "aim": {},
    "sweep": {"name": NAME, "resume": bool},
    "boards": {"name": NAME, "resume": bool},
    "take": {},
    "enough": {},
    "enough of all": {},
    "calibrate": {"name": NAME},
    "reconstruct": {"name": NAME},
    "compare": {"name": NAME, "other": NAME},
    "lost": {"stop": bool},
    "jog": {"deg": Range(-3600.0, 3600.0)},
    "light": {"on": bool},
    "expose": {"exposure_ms": Range(0.001, 10_000.0), "gain_db": Range(-100.0, 100.0)},
    "auto": {},
    "use": {"name": NAME},
    "recalibrate": {"name": NAME},
    "plan": {"name": NAME},
    "mesh": {"name": NAME},
    "report": {"name": NAME},
    "delete": {"name": NAME},
    "rename": {"name": NAME, "other": NAME},
}
"""Orders, and the fields that belong to each."""


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
    if wanted is None or set(found) != {"do", *wanted}:
        raise BadOrder("an order that is not known; load the page again.")
    for name, kind in wanted.items():
        if expected := _expected(found[name], kind):
            raise BadOrder(f"{name}: expected {expected}.")
    numbers = {name: float(found[name]) for name, kind in wanted.items() if isinstance(kind, Range)}
    return Order(**found | numbers)


def _expected(value: Any, kind: Any) -> str:
    """What a field should be; "" if it is that."""
    if isinstance(kind, Range):
        # NaN is in no range; Python compares integers of any length.
        right = isinstance(value, int | float) and not isinstance(value, bool) and kind.low <= value <= kind.high
        return "" if right else f"a number of {kind.low:g} to {kind.high:g}"
    if kind is bool:
        return "" if isinstance(value, bool) else "true or false"
    right = isinstance(value, str) and kind.fullmatch(value) is not None and ".." not in value
    return "" if right else "letters, digits, dots, dashes and underscores, 64 at most"
