"""Arguments that several verbs share, and checks of their values before the work begins."""

import math
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxscan.errors import OptionError


CapturePath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
CloudPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CLOUD")]
ConfigPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CONFIG")]
OutputPath = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
CloudUnit = Annotated[
    Literal["m", "cm", "mm", "inch", "foot", "us-foot"] | None,
    tyro.conf.arg(help="Unit of a cloud of another program; without, it is guessed where the file does not say it."),
]
CloudColumns = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="NAMES",
        help="Columns of a text, PLY or PCD of another program in their order: x, y, z, i (intensity), r, g, b, nx, "
        "ny, nz, sigma_random, and - for one to leave out.",
    ),
]
CloudColours = Annotated[
    Literal["1", "255", "1023", "4095", "65535", "none"] | None,
    tyro.conf.arg(help="Number of full brightness in a cloud of another program; none leaves its colours out."),
]
CloudUp = Annotated[
    Literal["x", "-x", "y", "-y", "z", "-z"] | None,
    tyro.conf.arg(help="Direction of the cloud that is up: it becomes z. Ours have z up."),
]
CLOUD_SUFFIXES = ".ply .npz .e57 .las .laz .pcd .xyz .ptx"
"""Suffixes of `jaxscan.files.clouds.WRITERS`, written out so that `--help` does not load the readers and writers."""
CloudOutputPath = Annotated[
    Path,
    tyro.conf.arg(aliases=["-o"], help=f"Cloud to write; the suffix chooses the format ({CLOUD_SUFFIXES})."),
]
CalibrationPath = Annotated[Path, tyro.conf.arg(aliases=["-c"])]
OptionalCalibrationPath = Annotated[Path | None, tyro.conf.arg(aliases=["-c"])]


MAX_COORDINATE_M = 1e8
"""Largest coordinate that an option accepts [m]: more than twice around the Earth."""


def at_least(smallest: int, option: str, value: int | None) -> None:
    """Refuse a count below `smallest`.

    Raises:
        OptionError: With the option's name and the values that it accepts.
    """
    if value is not None and value < smallest:
        raise OptionError(f"{option}: found {value}, expected {smallest} or more.")


def positive(option: str, value: float) -> None:
    """Refuse a length that is not above 0.

    Raises:
        OptionError: With the option's name and the values that it accepts.
    """
    if not (math.isfinite(value) and value > 0):
        raise OptionError(f"{option}: found {value:g}, expected a number above 0.")


def range_limits(smallest: str, low: float, largest: str, high: float) -> None:
    """Refuse range limits [m] between which there is no distance.

    Raises:
        OptionError: With the option's name and the values that it accepts.
    """
    for option, value in ((smallest, low), (largest, high)):
        if not (math.isfinite(value) and value >= 0):
            raise OptionError(f"{option}: found {value:g}, expected a distance in metres.")
    if low >= high:
        raise OptionError(f"{largest}: found {high:g}, expected more than {smallest}, which is {low:g}.")


def coordinates(option: str, values: tuple[float, ...]) -> None:
    """Refuse coordinates [m] that are not finite or further away than any scan or survey grid reaches.

    Raises:
        OptionError: With the option's name and the values that it accepts.
    """
    if not all(math.isfinite(value) and abs(value) <= MAX_COORDINATE_M for value in values):
        found = " ".join(f"{value:g}" for value in values)
        raise OptionError(f"{option}: found {found}, expected metres within {MAX_COORDINATE_M:g} of 0.")
