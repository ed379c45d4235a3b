"""Numbers with their units on the command line: `4m`, `1mm`, `3.45um`, `0.1px`, `0.2deg`, `2448x2048`."""

import re

from jaxscan.errors import OptionError


METRES = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6}
"""Units of lengths; a number alone is in metres."""
MICROMETRES = {"um": 1.0, "µm": 1.0, "μm": 1.0}
PIXELS = {"": 1.0, "px": 1.0}
DEGREES = {"": 1.0, "deg": 1.0, "°": 1.0}
MOST_PIXELS = 100_000_000
_NUMBER = re.compile(r"([0-9]{1,9}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})\s?([a-zA-Zµμ°]*)")
_SIZE = re.compile(r"([0-9]{1,5})\s?[x×]\s?([0-9]{1,5})")


def quantity(option: str, text: str, units: dict[str, float], limits: tuple[float, float]) -> float:
    """A number with its unit.

    Args:
        option: Name of the option, for messages.
        text: What was typed.
        units: Accepted units and their sizes; "" for a number alone.
        limits: Smallest and largest value, in the unit of size 1.

    Raises:
        OptionError: If it is no number, has another unit, or lies outside the limits.
    """
    found = _NUMBER.fullmatch(text.strip())
    known = ", ".join(unit for unit in units if unit)
    if found is None or found[2] not in units:
        raise OptionError(f"{option}: found {text[:40]!r}, expected a number above 0 with one of the units {known}.")
    value = float(found[1]) * units[found[2]]
    low, high = limits
    if not low <= value <= high:
        base = next(unit for unit, size in units.items() if unit and size == 1.0)
        raise OptionError(f"{option}: found {text[:40]!r}, expected {low:g} {base} to {high:g} {base}.")
    return value


def image_size(option: str, text: str, limits: tuple[int, int]) -> tuple[int, int]:
    """Width and height in pixels.

    Raises:
        OptionError: If it is not WIDTHxHEIGHT within the limits.
    """
    found = _SIZE.fullmatch(text.strip())
    low, high = limits
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(low <= side <= high for side in size):
        raise OptionError(f"{option}: found {text[:40]!r}, expected WIDTHxHEIGHT of {low} to {high} px, as 2448x2048.")
    if size[0] * size[1] > MOST_PIXELS:
        raise OptionError(f"{option}: found {text[:40]!r}, expected at most {MOST_PIXELS // 10**6} megapixels.")
    return size
