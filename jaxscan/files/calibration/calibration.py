"""Calibrations on disk: JSON that people read, and the observations beside it, so that anyone can solve again."""

import dataclasses
import functools
import hashlib
import json
import math
import operator
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import numpy as np
import pydantic

from jaxscan.calibration import Calibration, CalibrationSettings, Quality
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration.model import CALIBRATION_FORMAT, CalibrationTable, CameraTable
from jaxscan.files.capture import BoardTable
from jaxscan.files.disk import (
    MEGABYTE,
    ImageSize,
    Part,
    check,
    check_arrays,
    check_writable,
    file_digest,
    parse_json,
    read_arrays,
    read_bounded,
    readable_json,
    write_arrays,
    write_together,
)
from jaxscan.geometry import MOTIONS, AbstractCamera, Carries, Scanner, camera_doubts, is_pose, scanner_doubts
from jaxscan.geometry.scanner import Up
from jaxscan.observation import CONTRAST_CLASSES, BoardViews, Observations, StripeViews


# Larger numbers are nonsense, and formatting and arithmetic would fail.
_LARGEST, _LARGEST_INTEGER, _DEEPEST = 1e100, 2**53, 20


def quality_table(quality: Quality) -> dict[str, Any]:
    """The quality as JSON; keys without a value are left out."""
    if quality == Quality():
        return {}
    known = lambda items: {key: value for key, value in items if value is not None}
    return finite(dataclasses.asdict(quality, dict_factory=known))


def read_quality(table: dict[str, Any]) -> Quality:
    """The quality from the table of a file.

    A key whose value has the wrong type counts as missing, and unknown keys are ignored: a calibration
    can be used even if the quality in its file is damaged.
    """
    known = {}
    for key, value in table.items():
        try:
            if key in Quality.__dataclass_fields__ and _is_usable(value):
                # Strict JSON: no number in quotes, no truth value as a number, but a list for a tuple.
                alone = _adapter().validate_json(json.dumps({key: value}), strict=True)
                known[key] = getattr(alone, key)
        except pydantic.ValidationError:
            continue
    return Quality(**known)


_adapter = functools.cache(lambda: pydantic.TypeAdapter(Quality))


def _is_usable(value: Any, depth: int = 0) -> bool:
    """Whether a JSON value is not nested too deeply, and its numbers are not too large."""
    if isinstance(value, dict | list):
        items = value.values() if isinstance(value, dict) else value
        return depth < _DEEPEST and all(_is_usable(item, depth + 1) for item in items)
    return not isinstance(value, int | float) or abs(value) <= (_LARGEST_INTEGER if type(value) is int else _LARGEST)


def finite(value: Any) -> Any:
    """The same value with null for numbers that are not finite, which JSON cannot hold (a prior switched off)."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# The file may come from anyone, so the length of the solve is bounded.
_MAX_STEPS = 10_000


def stored_settings(provenance: dict[str, Any], *, name: str) -> CalibrationSettings:
    """Settings from the provenance of a calibration; keys that an older file lacks have their defaults.

    Raises:
        CalibrationError: With the key, if a value is not allowed.
    """
    settings = provenance.get("settings", {})
    if not isinstance(settings, dict):
        raise CalibrationError(f"{name}: provenance.settings: found {settings!r:.60}, expected a table.")
    priors = settings.get("priors", {})
    if isinstance(priors, dict):
        # JSON has no infinity: a prior that is switched off is written as null.
        priors = {key: math.inf if value is None else value for key, value in priors.items()}
    try:
        found = pydantic.TypeAdapter(CalibrationSettings).validate_python({**settings, "priors": priors})
    except pydantic.ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        key = ".".join(str(part) for part in ("provenance", "settings", *first["loc"]))
        raise CalibrationError(f"{name}: {key[:90]}: found {first['input']!r:.60}, {first['msg']}.") from None
    numbers = (found.huber, found.reject_any, found.reject_all, *found.priors.values())
    if not all(number > 0 for number in numbers) or not 1 <= found.max_steps <= _MAX_STEPS:
        raise CalibrationError(
            f"{name}: provenance.settings: priors and thresholds must be above 0, and max_steps 1 to {_MAX_STEPS}."
        )
    return found


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
    "poses": (np.floating, ("records", 4, 4)),
}
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


def _observations_writer(observations: Observations, path: Path) -> Callable[[Part], None]:
    """The function that writes the observations to a file, which is then to be renamed to `path`."""
    board = {"type": type(observations.board).__name__.lower(), **vars(observations.board)}
    about = {"format": OBSERVATIONS_FORMAT, "board": board}
    about |= {name: getattr(observations, name) for name in _PLAIN}
    # The same checks as on reading: a board may be of a kind that files do not know.
    check(_About, about, name=str(path), error=CalibrationError)
    every = {name: operator.attrgetter(name)(observations) for name in (*_ARRAYS, *_OPTIONAL)}
    arrays = {name: np.asarray(values) for name, values in every.items() if values is not None}
    return lambda part: write_arrays(part, {"about": np.array(readable_json(about)), **arrays})


def _holds_observations(path: Path) -> bool:
    about = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES, only="about").get("about")
    return about is not None and OBSERVATIONS_FORMAT in str(about)


def _is_observations(path: Path) -> bool:
    """Whether a file holds observations; False for a damaged file."""
    try:
        return _holds_observations(path)
    except CalibrationError:
        return False


def _observations_in(path: Path) -> Observations | None:
    """The observations in a file beside a calibration; None where it holds something else."""
    try:
        return _read_observations(path) if _holds_observations(path) else None
    except CalibrationError as problem:
        reason = str(problem).removeprefix(f"{path}: ").removesuffix(".")
        raise CalibrationError(
            f"{path}: the observations are damaged ({reason}): restore the file, or move it away to use the "
            "calibration without observations."
        ) from problem


def _read_observations(path: Path) -> Observations:
    arrays = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES)
    value = parse_json(str(arrays.get("about", "null")).encode(), name=str(path), error=CalibrationError)
    about = check(_About, value, name=str(path), error=CalibrationError)
    board = about.board.board()
    known = {"corners": len(board.corners())}
    there = _ARRAYS | {name: kind for name, kind in _OPTIONAL.items() if name in arrays}
    sizes = check_arrays(arrays, there, known, name=str(path), error=CalibrationError)
    counts = {"stripes.view": sizes["views"], "stripes.laser": len(about.laser_names)}
    # Indices of all entries: those of points that are not valid are looked up too.
    for name, count in (
        counts | {name: CONTRAST_CLASSES for name in _OPTIONAL if name in arrays and name != "poses"}
    ).items():
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
        poses=_poses_of(arrays, about.carries, path),
        **{name: getattr(about, name) for name in _PLAIN},
    )


def _poses_of(arrays: Mapping[str, np.ndarray], carries: Carries, path: Path) -> np.ndarray | None:
    """The poses of the hand in a file of observations."""
    if MOTIONS[carries].unit != "pose":
        return None
    poses, angle = arrays.get("poses", np.zeros((0, 4, 4))), arrays["corners.angle"]
    there = not len(angle) or (angle.min() >= 0 and angle.max() < len(poses))
    if not there or not all(is_pose(pose) for pose in poses):
        raise CalibrationError(f"{path}: poses: expected a rigid pose for every view.")
    return poses


_DIGESTS = "digests"


def _digests_of(tables: Mapping[str, Any], observations: Path | None = None) -> dict[str, str]:
    """The table of digests of a calibration file, of all other tables and the file of its observations."""
    digests = {"values": _values_digest(tables)}
    if observations is not None:
        digests["observations"] = file_digest(observations, error=CalibrationError)
    return digests


def _values_note(tables: Mapping[str, Any], name: str) -> str:
    """A sentence if the values of a calibration file do not match its digest; else "".

    A file without a digest, as a person writes it, gives none.
    """
    digests = tables.get(_DIGESTS)
    expected = digests.get("values") if isinstance(digests, dict) else None
    if expected is None or expected == _values_digest(tables):
        return ""
    return (
        f"{name}: its values have changed since jaxscan calibrate wrote it, so points may be wrong; calibrate again, "
        f'or, if the change is meant, remove "{_DIGESTS}" from the file.'
    )


def _require_own(table: CalibrationTable, path: Path, beside: Path, *, found: bool) -> None:
    """Refuse observations whose digest the calibration file beside them does not name."""
    digests = table.digests
    if digests is None:
        return
    if digests.observations is None:
        # A calibration without observations may have an unrelated file of that name beside it.
        own = not (found and digests.values is not None)
    else:
        own = file_digest(beside, error=CalibrationError) == digests.observations
    if not own:
        raise CalibrationError(
            f"{beside}: the observations beside {path.name} belong to another calibration or are damaged: calibrate "
            "again, copy the right file here, or move this one away to use the calibration without observations."
        )


def _values_digest(tables: Mapping[str, Any]) -> str:
    """Digest of the parsed values, so that another layout of the text does not matter."""
    values = {key: value for key, value in tables.items() if key != _DIGESTS}
    return "sha256:" + hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


MAX_CALIBRATION_BYTES = 16 * MEGABYTE


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration as `path`, and its observations, where it has any, as `<stem>.npz`.

    Args:
        calibration: Calibration of a scanner, or of a camera alone.
        path: Ends in `.json`. Existing files are replaced when the new ones are complete.

    Raises:
        CalibrationError: If it is no calibration, is inconsistent, or cannot be written.
    """
    if not isinstance(calibration, Calibration):
        remedy = "; save_scanner writes a scanner" if isinstance(calibration, Scanner) else ""
        raise CalibrationError(f"{path}: found a {type(calibration).__name__}, expected a Calibration{remedy}.")
    path = Path(path)
    check_calibration_path(path, with_observations=calibration.observations is not None)
    try:
        text = readable_json(_tables(calibration))
    except (TypeError, ValueError) as problem:
        raise CalibrationError(f"{path}: cannot be written: {problem}.") from problem
    # The same checks as on reading, on the same bytes, so that every written file can be read.
    tables = _parse(text.encode(), name=str(path))[0]
    beside = observations_path(path)
    tables[_DIGESTS] = _digests_of(tables)
    writers: dict[Path, Callable[[Part], None]] = {}
    if calibration.observations is not None:
        write = _observations_writer(calibration.observations, beside)

        def write_beside(part: Part) -> None:
            write(part)
            tables[_DIGESTS] = _digests_of(tables, part)

        writers[beside] = write_beside

    def write_own(part: Part) -> None:
        part.write_bytes(readable_json(tables).encode())

    # The names change one right after the other: a calibration with observations of another is refused.
    writers[path] = write_own
    write_together(writers, error=CalibrationError)
    if calibration.observations is None and _is_observations(beside):
        # The old observations belong to the calibration that was just replaced.
        beside.unlink()


def save_scanner(scanner: Scanner, path: str | Path) -> None:
    """Write a scanner, as of `Scanner.from_parts`, as a calibration file that `load_scanner` reads.

    Args:
        scanner: The scanner; its covariance is written where it has one.
        path: Ends in `.json`. An existing file is replaced when the new one is complete.

    Raises:
        CalibrationError: If it is no scanner, its numbers do not fit one another, or it cannot be written.
    """
    if not isinstance(scanner, Scanner):
        raise CalibrationError(f"{path}: found a {type(scanner).__name__}, expected a Scanner.")
    covariance = np.zeros((0, 0)) if scanner.covariance is None else np.asarray(scanner.covariance, np.float64)
    order = scanner.parameter_names() if covariance.size else ()
    save_calibration(Calibration(scanner.camera, scanner, order, covariance), path)


def check_calibration_path(path: str | Path, *, with_observations: bool = True) -> None:
    """Check that a calibration can be written under this name, before the solve.

    Args:
        path: The calibration file.
        with_observations: Whether observations will be written beside it.

    Raises:
        CalibrationError: If the suffix is `.npz`, which the observations have, or a file cannot be written.
    """
    if Path(path).suffix.lower() == ".npz":
        raise CalibrationError(
            f"{path}: a calibration is JSON; end its name in .json (the .npz beside it is made too)."
        )
    check_writable(path, error=CalibrationError)
    beside = observations_path(Path(path))
    if with_observations:
        check_writable(beside, error=CalibrationError)
        if os.path.exists(beside) and not _is_observations(beside):
            raise CalibrationError(
                f"{beside}: exists and holds no observations; choose another name for the calibration."
            )


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration, with its observations where they lie beside it.

    Args:
        path: The JSON file.

    Returns:
        The calibration; `scanner` is None where the file holds a camera alone, `observations`
        is None where there are none.

    Raises:
        CalibrationError: One line with the key, the value found and the values allowed; or if the observations beside
            it are not those that it names.
    """
    path = Path(path)
    table = _load(path)[1]
    scanner, covariance = table.scanner(), table.covariance
    beside, observations = observations_path(path), None
    if os.path.exists(beside):
        observations = _observations_in(beside)
        _require_own(table, path, beside, found=observations is not None)
    return Calibration(
        camera=table.camera.camera() if scanner is None else scanner.camera,
        scanner=scanner,
        order=() if covariance is None else covariance.order,
        covariance=np.zeros((0, 0)) if covariance is None else covariance.array(),
        quality=read_quality(table.quality),
        observations=observations,
        provenance=table.provenance,
    )


def load_scanner(path: str | Path) -> Scanner:
    """Read the scanner of a calibration file; the JSON alone suffices.

    Args:
        path: The JSON file.

    Returns:
        The scanner with NumPy float64 leaves, and its covariance where the file has one.

    Raises:
        CalibrationError: If the file is missing or wrong, or holds no laser sheet.
    """
    scanner = _load(path)[1].scanner()
    if scanner is None or not scanner.laser_names:
        parts = "a camera alone" if scanner is None else "camera and axis"
        raise CalibrationError(
            f"{path}: holds {parts}, without a laser sheet, so it cannot reconstruct; calibrate with a capture that "
            "has laser images, or add the sheet's plane under lasers."
        )
    return scanner


def load_parts(path: str | Path) -> tuple[AbstractCamera, Scanner | None]:
    """Camera, and sheets and motion where there are any, of a calibration file; the JSON alone suffices.

    Raises:
        CalibrationError: If the file is missing or wrong.
    """
    table = _load(path)[1]
    return table.camera.camera(), table.scanner()


def calibration_notes(path: str | Path) -> list[str]:
    """Warnings for users of a calibration file.

    Raises:
        CalibrationError: If the file is missing or wrong.
    """
    tables, table = _load(path)
    notes = [_values_note(tables, str(path))]
    if read_quality(table.quality).converged is False:
        notes.append(f"{path}: its solve did not converge, so points and their sigmas may be wrong; calibrate again.")
    if table.covariance is None and table.lasers:
        notes.append(f"{path}: has no covariance, so it counts as exact: sigmas hold the noise of the stripes alone.")
    scanner = table.scanner()
    doubts = camera_doubts(table.camera.camera()) if scanner is None else scanner_doubts(scanner)
    return [note for note in (*notes, *(f"{path}: {doubt.said}." for doubt in doubts)) if note]


def calibration_digest(path: str | Path) -> str:
    """The sha256 of a calibration file, as "sha256:<hex>", by which clouds name it.

    Raises:
        CalibrationError: If it cannot be read.
    """
    return file_digest(path, error=CalibrationError)


def _load(path: str | Path) -> tuple[dict[str, Any], CalibrationTable]:
    """A calibration file as it stands, and checked."""
    return _parse(read_bounded(path, MAX_CALIBRATION_BYTES, error=CalibrationError), name=str(path))


def _parse(data: bytes, *, name: str) -> tuple[dict[str, Any], CalibrationTable]:
    tables = parse_json(data, name=name, error=CalibrationError)
    table = check(CalibrationTable, tables, name=name, error=CalibrationError)
    if table.covariance is not None:
        found, expected = table.covariance.order, (table.scanner() or table.camera.camera()).parameter_names()
        if found != expected:
            raise CalibrationError(
                f"{name}: covariance.order: found {', '.join(found)[:60]}, expected {', '.join(expected)}."
            )
    return tables, table


def _tables(calibration: Calibration) -> dict[str, Any]:
    scanner, observations = calibration.scanner, calibration.observations
    up = scanner.up if scanner is not None else observations.up if observations is not None else "-v"
    tables: dict[str, Any] = {"format": CALIBRATION_FORMAT, "camera": CameraTable.of(calibration.camera, up)}
    if scanner is not None:
        # Numbers in the file are float64.
        scanner = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), scanner)
        sheets = scanner.lasers
        tables["lasers"] = [
            {"name": name, "normal": normal, "distance_m": distance, "bow": bow, "basis": basis}
            for name, normal, distance, bow, basis in zip(
                scanner.laser_names, sheets.normal, sheets.distance, sheets.bow, sheets.basis, strict=True
            )
        ]
        if scanner.turntable.fields:
            tables["turntable"] = scanner.turntable.table()
    tables["quality"] = quality_table(calibration.quality)
    tables["provenance"] = finite(calibration.provenance)
    if len(calibration.order) > 0:
        matrix = np.asarray(calibration.covariance, np.float64)
        tables["covariance"] = {"order": calibration.order, "scale": 1.0, "matrix": matrix}
    return tables
