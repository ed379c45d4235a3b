"""Arguments that several verbs share, and what is asked of them before the work begins."""

import math
from pathlib import Path
from typing import Annotated

import tyro

from jaxscan.errors import OptionError
from jaxscan.files.clouds import WRITERS


CapturePath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
CloudPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CLOUD")]
OutputPath = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
CLOUD_SUFFIXES = " ".join(WRITERS)
"""Suffixes of the formats that clouds can be written in."""
CloudOutputPath = Annotated[
    Path,
    tyro.conf.arg(aliases=["-o"], help=f"Cloud to write; the suffix chooses the format ({CLOUD_SUFFIXES})."),
]
CalibrationPath = Annotated[Path, tyro.conf.arg(aliases=["-c"])]


def at_least(smallest: int, option: str, value: int | None) -> None:
    """Refuse a count below `smallest`.

    Raises:
        OptionError: With the option's name and what may stand there.
    """
    if value is not None and value < smallest:
        raise OptionError(f"{option}: found {value}, expected {smallest} or more.")


def positive(option: str, *values: float) -> None:
    """Refuse lengths that are none.

    Raises:
        OptionError: With the option's name and what may stand there.
    """
    for value in values:
        if not (math.isfinite(value) and value > 0):
            raise OptionError(f"{option}: found {value:g}, expected a number above 0.")


def range_limits(smallest: str, low: float, largest: str, high: float) -> None:
    """Refuse ranges of distances [m] that hold none.

    Raises:
        OptionError: With the option's name and what may stand there.
    """
    for option, value in ((smallest, low), (largest, high)):
        if not (math.isfinite(value) and value >= 0):
            raise OptionError(f"{option}: found {value:g}, expected a distance in metres.")
    if low >= high:
        raise OptionError(f"{largest}: found {high:g}, expected more than {smallest}, which is {low:g}.")


def finite(option: str, values: tuple[float, ...]) -> None:
    """Refuse places that are nowhere.

    Raises:
        OptionError: With the option's name and what may stand there.
    """
    if not all(math.isfinite(value) for value in values):
        raise OptionError(f"{option}: found {' '.join(f'{value:g}' for value in values)}, expected finite numbers.")
