"""Calibrations on disk: a JSON file that suffices to reconstruct, and an NPZ file with the observations."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration.binding import DIGESTS, digests_of, require_own, values_note
from jaxscan.files.calibration.model import CALIBRATION_FORMAT, CalibrationTable, CameraTable
from jaxscan.files.calibration.motions import motion_table
from jaxscan.files.calibration.observations import (
    check_observations_path,
    find_observations,
    is_observations,
    observations_path,
    observations_writer,
)
from jaxscan.files.calibration.quality import finite, quality_table, read_quality
from jaxscan.files.disk import (
    MEGABYTE,
    Part,
    check,
    check_writable,
    file_digest,
    parse_json,
    read_bounded,
    readable_json,
    write_together,
)
from jaxscan.geometry import AbstractCamera, Scanner, camera_doubts, scanner_doubts


MAX_CALIBRATION_BYTES = 16 * MEGABYTE


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration as `path`, and its observations, where it has any, as `<stem>.npz`.

    Args:
        calibration: Calibration of a scanner, or of a camera alone.
        path: Ends in `.json`. Existing files are replaced when the new ones are complete.

    Raises:
        CalibrationError: If the calibration is inconsistent, or cannot be written.
    """
    path = Path(path)
    check_calibration_path(path, with_observations=calibration.observations is not None)
    try:
        text = readable_json(_tables(calibration))
    except (TypeError, ValueError) as problem:
        raise CalibrationError(f"{path}: cannot be written: {problem}.") from problem
    # The same checks as on reading, on the same bytes, so that every written file can be read.
    tables = _value(text.encode(), name=str(path))
    _parse(tables, name=str(path))
    beside = observations_path(path)
    tables[DIGESTS] = digests_of(tables)
    writers: dict[Path, Callable[[Part], None]] = {}
    if calibration.observations is not None:
        write = observations_writer(calibration.observations, beside)

        def write_beside(part: Part) -> None:
            write(part)
            tables[DIGESTS] = digests_of(tables, part)

        writers[beside] = write_beside

    def write_own(part: Part) -> None:
        part.write_bytes(readable_json(tables).encode())

    # The names change one right after the other: a calibration with observations of another is refused.
    writers[path] = write_own
    write_together(writers, error=CalibrationError)
    if calibration.observations is None and is_observations(beside):
        # They belong to the calibration that was just replaced.
        beside.unlink()


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
    if with_observations:
        check_observations_path(observations_path(Path(path)))


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
    table = _parse(_read(path), name=str(path))
    scanner, covariance = table.scanner(), table.covariance
    beside = observations_path(path)
    observations = find_observations(beside) if os.path.exists(beside) else None
    if os.path.exists(beside):
        require_own(table, path, beside, found=observations is not None)
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
    scanner = _parse(_read(Path(path)), name=str(path)).scanner()
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
    table = _parse(_read(Path(path)), name=str(path))
    return table.camera.camera(), table.scanner()


def calibration_notes(path: str | Path) -> list[str]:
    """Warnings for users of a calibration file.

    Raises:
        CalibrationError: If the file is missing or wrong.
    """
    tables = _read(Path(path))
    table, notes = _parse(tables, name=str(path)), [values_note(tables, str(path))]
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


def _read(path: Path) -> Any:
    return _value(read_bounded(path, MAX_CALIBRATION_BYTES, error=CalibrationError), name=str(path))


def _value(data: bytes, *, name: str) -> Any:
    return parse_json(data, name=name, error=CalibrationError)


def _parse(value: Any, *, name: str) -> CalibrationTable:
    table = check(CalibrationTable, value, name=name, error=CalibrationError)
    if table.covariance is not None:
        found, expected = table.covariance.order, (table.scanner() or table.camera.camera()).parameter_names()
        if found != expected:
            raise CalibrationError(
                f"{name}: covariance.order: found {', '.join(found)[:60]}, expected {', '.join(expected)}."
            )
    return table


def _tables(calibration: Calibration) -> dict[str, Any]:
    scanner, observations = calibration.scanner, calibration.observations
    up = scanner.up if scanner is not None else observations.up if observations is not None else "-v"
    tables: dict[str, Any] = {"format": CALIBRATION_FORMAT, "camera": CameraTable.of(calibration.camera, up)}
    if scanner is not None:
        # Numbers in the file are float64.
        scanner = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), scanner)
        sheets, motion = scanner.lasers, motion_table(scanner.turntable)
        tables["lasers"] = [
            {"name": name, "normal": normal, "distance_m": distance, "bow": bow, "basis": basis}
            for name, normal, distance, bow, basis in zip(
                scanner.laser_names, sheets.normal, sheets.distance, sheets.bow, sheets.basis, strict=True
            )
        ]
        if motion is not None:
            tables["turntable"] = motion
    tables["quality"] = quality_table(calibration.quality)
    tables["provenance"] = finite(calibration.provenance)
    if len(calibration.order) > 0:
        matrix = np.asarray(calibration.covariance, np.float64)
        tables["covariance"] = {"order": calibration.order, "scale": 1.0, "matrix": matrix}
    return tables
