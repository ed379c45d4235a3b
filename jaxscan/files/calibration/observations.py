"""The observations beside a calibration file, so that anyone can solve again: NPZ."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic

from jaxscan.errors import CalibrationError
from jaxscan.files.capture import BoardTable, board_table
from jaxscan.files.disk import (
    FileModel,
    ImageSize,
    check,
    parse_json,
    read_arrays,
    readable_json,
    write_arrays,
    write_atomically,
)
from jaxscan.geometry.scanner import Up
from jaxscan.geometry.turntable import Carries
from jaxscan.observation import BoardViews, Observations, StripeViews


OBSERVATIONS_FORMAT: Literal["jaxscan-observations/1"] = "jaxscan-observations/1"
MAX_ARRAY_BYTES = 1 << 30

# The letter is NumPy's for the kind of number; the extents refer to `_About`'s board and each other.
_ARRAYS = {
    "corners.q": ("f", ("views", "corners", 2)),
    "corners.sigma": ("f", ("views", "corners")),
    "corners.valid": ("b", ("views", "corners")),
    "corners.angle": ("f", ("views",)),
    "corners.placement": ("i", ("views",)),
    "corners.record": ("i", ("views",)),
    "stripes.q": ("f", ("stripes", "points", 2)),
    "stripes.sigma": ("f", ("stripes", "points")),
    "stripes.valid": ("b", ("stripes", "points")),
    "stripes.view": ("i", ("stripes",)),
    "stripes.laser": ("i", ("stripes",)),
}


def _in_millimetres(board: Any) -> Any:
    """A board as this file has it, lengths in metres, as the table that every other file has."""
    if not isinstance(board, dict):
        return board
    lengths = {key: board[key] for key in ("square", "marker") if isinstance(board.get(key), int | float)}
    others = {key: value for key, value in board.items() if key not in lengths}
    return others | {f"{key}_mm": 1000 * value for key, value in lengths.items()}


def _in_metres(table: FileModel) -> dict[str, Any]:
    """The table of a board as this file has it."""
    items = table.model_dump().items()
    return {key.removesuffix("_mm"): value / 1000 if key.endswith("_mm") else value for key, value in items}


class _About(ImageSize):
    """What is not an array, as JSON; lengths in metres, as the board itself has them."""

    format: Literal["jaxscan-observations/1"]
    board: Annotated[BoardTable, pydantic.BeforeValidator(_in_millimetres)]
    laser_names: tuple[str, ...]
    up: Up
    carries: Carries


def observations_path(path: Path) -> Path:
    """Where the observations of a calibration file lie."""
    return path.with_suffix(".npz")


def write_observations(observations: Observations, path: Path) -> None:
    """Write the observations, whole or not at all.

    Raises:
        CalibrationError: If another file stands there, or the file cannot be written.
        CaptureError: If the board is of an unknown kind.
    """
    if path.exists() and not is_observations(path):
        raise CalibrationError(f"{path}: exists and holds no observations; choose another name for the calibration.")
    about = {
        "format": OBSERVATIONS_FORMAT,
        "board": _in_metres(board_table(observations.board)),
        "width": observations.width,
        "height": observations.height,
        "laser_names": list(observations.laser_names),
        "up": observations.up,
        "carries": observations.carries,
    }
    arrays = {"about": np.array(readable_json(about))}
    for name in _ARRAYS:
        part, field = name.split(".")
        arrays[name] = np.asarray(getattr(getattr(observations, part), field))
    write_atomically(path, lambda part: write_arrays(part, arrays), error=CalibrationError)


def is_observations(path: Path) -> bool:
    """Whether a file is one that `write_observations` wrote."""
    try:
        about = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES, only="about").get("about")
    except CalibrationError:
        return False
    return about is not None and OBSERVATIONS_FORMAT in str(about)


def read_observations(path: Path) -> Observations:
    """The observations that belong to a calibration.

    Raises:
        CalibrationError: If they are damaged.
    """
    arrays = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES)
    text = str(arrays.get("about", "null")).encode()
    about = check(
        _About, parse_json(text, name=str(path), error=CalibrationError), name=str(path), error=CalibrationError
    )
    board = about.board.board()
    extents: dict[str | int, int] = {"corners": len(board.corners()), 2: 2}
    for name, (kind, axes) in _ARRAYS.items():
        array = arrays.get(name)
        if array is None:
            raise CalibrationError(f"{path}: {name} is missing.")
        expected = [extents.setdefault(axis, size) for axis, size in zip(axes, array.shape, strict=False)]
        if array.dtype.kind != kind or list(array.shape) != expected or array.ndim != len(axes):
            raise CalibrationError(f"{path}: {name}: found {array.dtype} with shape {array.shape}, expected {axes}.")
        if kind == "f" and not np.isfinite(array).all():
            raise CalibrationError(f"{path}: {name} is not finite everywhere.")
    for name, count in (("stripes.view", extents["views"]), ("stripes.laser", len(about.laser_names))):
        if ((arrays[name] < 0) | (arrays[name] >= count)).any():
            raise CalibrationError(f"{path}: {name}: found an index outside 0 ... {count - 1}.")

    def group(part: str) -> dict[str, np.ndarray]:
        return {name.removeprefix(part): arrays[name] for name in _ARRAYS if name.startswith(part)}

    return Observations(
        board=board,
        corners=BoardViews(**group("corners.")),
        stripes=StripeViews(**group("stripes.")),
        width=about.width,
        height=about.height,
        laser_names=about.laser_names,
        up=about.up,
        carries=about.carries,
    )
