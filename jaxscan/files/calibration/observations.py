"""The observations beside a calibration file, so that anyone can solve again: NPZ."""

import operator
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic

from jaxscan.errors import CalibrationError
from jaxscan.files.capture import BoardTable
from jaxscan.files.disk import (
    ImageSize,
    Part,
    check,
    check_arrays,
    check_writable,
    parse_json,
    read_arrays,
    readable_json,
    write_arrays,
)
from jaxscan.geometry.motions import Carries
from jaxscan.geometry.scanner import Up
from jaxscan.observation import CONTRAST_CLASSES, BoardViews, Observations, StripeViews


OBSERVATIONS_FORMAT: Literal["jaxscan-observations/1"] = "jaxscan-observations/1"
MAX_ARRAY_BYTES = 1 << 30

_ARRAYS: dict[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "corners.q": (np.floating, ("views", "corners", 2)),
    "corners.sigma": (np.floating, ("views", "corners")),
    "corners.valid": (np.bool_, ("views", "corners")),
    "corners.angle": (np.floating, ("views",)),
    "corners.placement": (np.signedinteger, ("views",)),
    "corners.record": (np.signedinteger, ("views",)),
    "stripes.q": (np.floating, ("stripes", "points", 2)),
    "stripes.sigma": (np.floating, ("stripes", "points")),
    "stripes.valid": (np.bool_, ("stripes", "points")),
    "stripes.view": (np.signedinteger, ("stripes",)),
    "stripes.laser": (np.signedinteger, ("stripes",)),
}
_OPTIONAL: dict[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "stripes.contrast": (np.signedinteger, ("stripes", "points")),
}
"""Arrays that observations may lack."""
_RANGES = {
    "corners.q": (-1e6, 1e6),
    "corners.sigma": (1e-6, 1e6),
    "corners.angle": (-1e6, 1e6),
    "stripes.q": (-1e6, 1e6),
    "stripes.sigma": (1e-6, 1e6),
}
"""Limits of the numbers of valid points [px, rad]: squares of others would not be finite."""
# Fields of `Observations` that are stored as they are, as JSON.
_PLAIN = ("width", "height", "laser_names", "up", "carries")


_LENGTHS = ("square", "marker", "diameter", "tag")
"""Fields of boards that are lengths."""
_NAMES = {"circles": {"square": "spacing"}, "aprilgrid": {"square": "gap"}}
"""Names of fields in the tables of captures, where they have others."""


def _in_millimetres(board: Any) -> Any:
    """A board with lengths in metres, as in this file, as the table of all other files, in millimetres."""
    if not isinstance(board, dict):
        return board
    lengths = {key: board[key] for key in _LENGTHS if isinstance(board.get(key), int | float)}
    others = {key: value for key, value in board.items() if key not in lengths}
    names = _NAMES.get(str(board.get("type")), {})
    return others | {f"{names.get(key, key)}_mm": 1000 * value for key, value in lengths.items()}


class _About(ImageSize):
    """The fields that are not arrays, as JSON; lengths in metres."""

    format: Literal["jaxscan-observations/1"]
    board: Annotated[BoardTable, pydantic.BeforeValidator(_in_millimetres)]
    laser_names: tuple[str, ...]
    up: Up
    carries: Carries


def observations_path(path: Path) -> Path:
    """The file of the observations that belong to a calibration file."""
    return path.with_suffix(".npz")


def check_observations_path(path: Path) -> None:
    """Check that observations can be written under this name.

    Raises:
        CalibrationError: If another file has this name, or the file cannot be written.
    """
    check_writable(path, error=CalibrationError)
    if os.path.exists(path) and not is_observations(path):
        raise CalibrationError(f"{path}: exists and holds no observations; choose another name for the calibration.")


def observations_writer(observations: Observations, path: Path) -> Callable[[Part], None]:
    """The function that writes the observations to a file, which is then to be renamed to `path`.

    Raises:
        CalibrationError: If another file has the name `path`, the board is of an unknown kind, or the file cannot be
            written.
    """
    check_observations_path(path)
    board = {"type": type(observations.board).__name__.lower(), **vars(observations.board)}
    about = {"format": OBSERVATIONS_FORMAT, "board": board}
    about |= {name: getattr(observations, name) for name in _PLAIN}
    # The same checks as on reading: a board may be of a kind that files do not know.
    check(_About, about, name=str(path), error=CalibrationError)
    every = {name: operator.attrgetter(name)(observations) for name in (*_ARRAYS, *_OPTIONAL)}
    arrays = {name: np.asarray(values) for name, values in every.items() if values is not None}
    arrays = {"about": np.array(readable_json(about)), **arrays}
    return lambda part: write_arrays(part, arrays)


def is_observations(path: Path) -> bool:
    """Whether a file is one that `observations_writer` writes."""
    try:
        about = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES, only="about").get("about")
    except CalibrationError:
        return False
    return about is not None and OBSERVATIONS_FORMAT in str(about)


def find_observations(path: Path) -> Observations | None:
    """The observations in a file beside a calibration; None where it holds something else.

    Raises:
        CalibrationError: If they are damaged.
    """
    try:
        about = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES, only="about").get("about")
        return None if about is None or OBSERVATIONS_FORMAT not in str(about) else _read(path)
    except CalibrationError as problem:
        reason = str(problem).removeprefix(f"{path}: ").removesuffix(".")
        raise CalibrationError(
            f"{path}: the observations are damaged ({reason}): restore the file, or move it away to use the "
            "calibration without observations."
        ) from problem


def _read(path: Path) -> Observations:
    arrays = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES)
    value = parse_json(str(arrays.get("about", "null")).encode(), name=str(path), error=CalibrationError)
    about = check(_About, value, name=str(path), error=CalibrationError)
    board = about.board.board()
    known = {"corners": len(board.corners())}
    there = _ARRAYS | {name: kind for name, kind in _OPTIONAL.items() if name in arrays}
    sizes = check_arrays(arrays, there, known, name=str(path), error=CalibrationError)
    counts = {"stripes.view": sizes["views"], "stripes.laser": len(about.laser_names)}
    # Indices of all entries: those of points that are not valid are looked up too.
    for name, count in (counts | {name: CONTRAST_CLASSES for name in _OPTIONAL if name in arrays}).items():
        if ((arrays[name] < 0) | (arrays[name] >= count)).any():
            raise CalibrationError(f"{path}: {name}: found an index outside 0 ... {count - 1}.")
    for name, (least, most) in _RANGES.items():
        values, valid = arrays[name], arrays.get(f"{name.split('.')[0]}.valid")
        seen = values if valid is None or values.ndim < valid.ndim else values[valid]
        if not ((seen >= least) & (seen <= most)).all():
            raise CalibrationError(f"{path}: {name}: found a number outside {least:g} ... {most:g}.")
    corners, stripes = (
        {name.removeprefix(part): arrays[name] for name in there if name.startswith(part)}
        for part in ("corners.", "stripes.")
    )
    return Observations(
        board=board,
        corners=BoardViews(**corners),
        stripes=StripeViews(**stripes),
        **{name: getattr(about, name) for name in _PLAIN},
    )
