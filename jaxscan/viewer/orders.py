"""What a page may ask for, checked: it comes from outside."""

import json
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxscan.errors import OptionError


MOST_BYTES = 1 << 16
_MOST_M = 1e7
Do = Literal["pick", "close", "room", "box", "cut", "undo", "remove", "clear", "save", "choose", "cancel"]
_KINDS = ("point", "distance", "height", "angle", "area", "flatness")
_WIDEST_RAD = 0.2


class Ray(NamedTuple):
    """Where somebody clicked, in the frame of the scene."""

    origin: np.ndarray
    direction: np.ndarray
    cone_rad: float


class Order(NamedTuple):
    """One order of a page."""

    do: Do
    what: str = ""
    """A kind of measurement, or "csv" or "json"."""
    ray: Ray | None = None
    shifts: tuple[tuple[int, np.ndarray], ...] = ()
    """The clouds that are shown, and where each stands [m]."""
    section: np.ndarray | None = None
    """Lowest and highest corner of what is shown [2, 3], m, in a frame that is turned about the scene's z axis."""
    turn_rad: float = 0.0
    id: int = 0
    backs: bool = True
    surface: bool = False
    """Whether the surface between the points is shown, so that a click beside them means one of them too."""


def parse_order(text: str, clouds: int) -> Order:
    """Read a message about so many clouds.

    Raises:
        OptionError: If it is no order.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        raise OptionError("expected JSON.") from None
    if not isinstance(found, dict):
        raise OptionError("expected an object.")
    do, what = found.get("do"), found.get("what", "")
    match do, what:
        case "choose", str() if what in _KINDS:
            return Order("choose", what)
        case "undo" | "clear" | "cancel" | "close", _:
            return Order(do)
        case "remove", _:
            return Order("remove", id=int(_number(found.get("id"))))
        case "save", "csv" | "json":
            return Order("save", what)
        case "room" | "pick" | "box" | "cut", _:
            section = found.get("section")
            if section is None and do in ("box", "cut"):
                raise OptionError("section: expected two corners.")
            return Order(
                do,
                ray=_ray(found) if do == "pick" else None,
                shifts=_shifts(found.get("clouds"), clouds),
                section=None if section is None else np.stack([_place(section, k) for k in (0, 1)]),
                turn_rad=_number(found.get("turn_rad", 0)),
                backs=found.get("backs") is not False,
                surface=found.get("surface") is True,
            )
    raise OptionError("no such order.")


def _ray(found: dict[str, Any]) -> Ray:
    direction = _numbers(found.get("direction"))
    cone = found.get("cone_rad")
    if not np.linalg.norm(direction) > 1e-6:
        raise OptionError("direction: expected a vector.")
    if isinstance(cone, bool) or not isinstance(cone, int | float) or not 0 < cone <= _WIDEST_RAD:
        raise OptionError(f"cone_rad: expected a number up to {_WIDEST_RAD}.")
    return Ray(_numbers(found.get("origin")), direction, float(cone))


def _shifts(found: Any, clouds: int) -> tuple[tuple[int, np.ndarray], ...]:
    if not isinstance(found, list) or len(found) > clouds:
        raise OptionError("clouds: expected a list of those that are shown.")
    shifts = []
    for one in found:
        number = one.get("number") if isinstance(one, dict) else None
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < clouds:
            raise OptionError("clouds: found a number that is none.")
        shifts.append((number, _numbers(one.get("shift"))))
    return tuple(shifts)


def _place(found: Any, number: int) -> np.ndarray:
    if not isinstance(found, list) or len(found) != 2:
        raise OptionError("section: expected two corners.")
    return _numbers(found[number])


def _numbers(found: Any) -> np.ndarray:
    """A vector [3] of finite numbers that are not too large."""
    if not isinstance(found, list) or len(found) != 3:
        raise OptionError("expected three numbers.")
    return np.array([_number(one) for one in found], np.float64)


def _number(found: Any) -> float:
    # NaN is not within either; Python compares integers of any length.
    if isinstance(found, bool) or not isinstance(found, int | float) or not abs(found) <= _MOST_M:
        raise OptionError("expected a number.")
    return float(found)
