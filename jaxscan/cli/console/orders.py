"""Orders of a page: JSON messages, of which only those that are listed mean something."""

import json
import re
from typing import Any, NamedTuple

from jaxscan.errors import JaxscanError


class BadOrder(JaxscanError):
    """A message that is no order."""


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
}
"""Orders, and the fields that belong to each."""


class Order(NamedTuple):
    """An order that is understood."""

    do: str
    name: str = ""
    other: str = ""
    resume: bool = False
    stop: bool = False


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
        value = found[name]
        if kind is bool:
            right = isinstance(value, bool)
        else:
            right = isinstance(value, str) and kind.fullmatch(value) is not None and ".." not in value
        if not right:
            raise BadOrder(f"{name}: expected letters, digits, dots, dashes and underscores, 64 at most.")
    return Order(**found)
