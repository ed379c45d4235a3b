"""Calibrations on disk: JSON that suffices to reconstruct, the observations in an NPZ beside it."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration.model import CALIBRATION_FORMAT, CalibrationTable, CameraTable
from jaxscan.files.calibration.observations import (
    is_observations,
    observations_path,
    read_observations,
    write_observations,
)
from jaxscan.files.calibration.quality import finite, quality_table, read_quality
from jaxscan.files.disk import (
    MEGABYTE,
    check,
    check_writable,
    file_digest,
    parse_json,
    read_bounded,
    readable_json,
    write_atomically,
)
from jaxscan.geometry import Scanner, point_up, stack_lasers


MAX_CALIBRATION_BYTES = 16 * MEGABYTE


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration as `path`, and its observations, where it has any, as `<stem>.npz`.

    Args:
        calibration: Of a whole scanner, or of a camera alone.
        path: Ends in `.json`. Existing files are replaced when the new ones are whole.

    Raises:
        CalibrationError: If the calibration is inconsistent, or cannot be written.
    """
    path = Path(path)
    check_calibration_path(path)
    try:
        text = readable_json(_tables(calibration))
    except (TypeError, ValueError) as problem:
        raise CalibrationError(f"{path}: cannot be written: {problem}.") from problem
    # What is written can be read: the same checks, on the same bytes.
    _parse(text.encode(), name=str(path))
    beside = observations_path(path)
    if calibration.observations is not None:
        write_observations(calibration.observations, beside)
    write_atomically(path, text.encode(), error=CalibrationError)
    if calibration.observations is None and is_observations(beside):
        # Those of the calibration that was just replaced.
        beside.unlink()


def check_calibration_path(path: str | Path) -> None:
    """See that a calibration can be written under this name, before the work that makes it.

    Raises:
        CalibrationError: If the suffix is that of the file beside it, or nothing can be written there.
    """
    if Path(path).suffix.lower() == ".npz":
        raise CalibrationError(
            f"{path}: a calibration is JSON; end its name in .json (the .npz beside it is made too)."
        )
    check_writable(path, error=CalibrationError)


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration, with its observations where they lie beside it.

    Args:
        path: The JSON file.

    Returns:
        The calibration; `scanner` is None where the file holds a camera alone, `observations`
        is None where there are none.

    Raises:
        CalibrationError: One line with the key, what was found and what may stand there.
    """
    path = Path(path)
    table = _read(path)
    scanner = _scanner(table) if table.turntable is not None else None
    beside = observations_path(path)
    observations = read_observations(beside) if beside.exists() and is_observations(beside) else None
    covariance = _covariance(table)
    return Calibration(
        camera=table.camera.camera() if scanner is None else scanner.camera,
        scanner=scanner,
        order=() if table.covariance is None else table.covariance.order,
        covariance=np.zeros((0, 0)) if covariance is None else covariance,
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
        CalibrationError: If the file is missing or wrong, or holds a camera alone.
    """
    path = Path(path)
    table = _read(path)
    if table.turntable is None:
        raise CalibrationError(
            f"{path}: holds a camera alone, without lasers and turntable, so it cannot reconstruct; "
            f"calibrate with a capture that has laser images at several table angles."
        )
    return _scanner(table)


def calibration_notes(path: str | Path) -> list[str]:
    """Remarks on a calibration file for those who use its scanner.

    Raises:
        CalibrationError: If the file is missing or wrong.
    """
    path = Path(path)
    if read_quality(_read(path).quality).converged is False:
        return [f"{path}: its solve did not converge, so points and their sigmas may be wrong; calibrate again."]
    return []


def calibration_digest(path: str | Path) -> str:
    """The sha256 of a calibration file, as "sha256:<hex>", by which clouds name it.

    Raises:
        CalibrationError: If it cannot be read.
    """
    return file_digest(path, error=CalibrationError)


def _read(path: Path) -> CalibrationTable:
    return _parse(read_bounded(path, MAX_CALIBRATION_BYTES, name=str(path), error=CalibrationError), name=str(path))


def _parse(data: bytes, *, name: str) -> CalibrationTable:
    value = parse_json(data, name=name, error=CalibrationError)
    table = check(CalibrationTable, value, name=name, error=CalibrationError)
    if table.covariance is not None:
        camera = table.camera.camera() if table.turntable is None else _scanner(table)
        expected = camera.parameter_names()
        if table.covariance.order != expected:
            raise CalibrationError(
                f"{name}: covariance.order: found {', '.join(table.covariance.order)}, expected {', '.join(expected)}."
            )
    return table


def _scanner(table: CalibrationTable) -> Scanner:
    if table.turntable is None:
        raise CalibrationError("The calibration holds a camera alone.")
    return Scanner(
        camera=table.camera.camera(),
        lasers=stack_lasers([one.sheet() for one in table.lasers]),
        turntable=point_up(table.turntable.turntable(), table.camera.up),
        covariance=_covariance(table),
        laser_names=tuple(one.name for one in table.lasers),
        up=table.camera.up,
    )


def _covariance(table: CalibrationTable) -> np.ndarray | None:
    if table.covariance is None:
        return None
    count = len(table.covariance.order)
    return np.array(table.covariance.matrix, np.float64).reshape(count, count)


def _tables(calibration: Calibration) -> dict[str, Any]:
    scanner, observations = calibration.scanner, calibration.observations
    up = scanner.up if scanner is not None else observations.up if observations is not None else "-v"
    tables: dict[str, Any] = {"format": CALIBRATION_FORMAT, "camera": CameraTable.of(calibration.camera, up)}
    if scanner is not None:
        tables["lasers"] = [_laser_table(scanner, index) for index in range(len(scanner.laser_names))]
        tables["turntable"] = {
            "carries": scanner.turntable.carries,
            "direction": _double(scanner.turntable.direction),
            "point_m": _double(scanner.turntable.point),
            "gain": _double(scanner.turntable.gain),
            "harmonics": _double(scanner.turntable.harmonics),
            "basis": _double(scanner.turntable.basis),
        }
    tables["quality"] = quality_table(calibration.quality)
    tables["provenance"] = finite(calibration.provenance)
    if len(calibration.order) > 0:
        tables["covariance"] = {
            "order": calibration.order,
            "scale": 1.0,
            "matrix": _double(calibration.covariance),
        }
    return tables


def _laser_table(scanner: Scanner, index: int) -> dict[str, Any]:
    sheets = scanner.lasers
    return {
        "name": scanner.laser_names[index],
        "normal": _double(sheets.normal[index]),
        "distance_m": _double(sheets.distance[index]),
        "bow": _double(sheets.bow[index]),
        "basis": _double(sheets.basis[index]),
    }


def _double(value: Any) -> Any:
    return np.asarray(value, np.float64).tolist()
