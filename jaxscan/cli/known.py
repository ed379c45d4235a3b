"""Parts of a rig that a command line gives: files of other programs, or plain numbers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxscan.calibration import KnownParts, Part
from jaxscan.errors import OptionError
from jaxscan.files.calibration import ReadCamera, load_parts, read_camera
from jaxscan.files.capture import Capture
from jaxscan.geometry import AbstractMotion, CameraModel, LaserSheet, LinearStage, Still, Turntable


def known_parts(
    capture: Capture,
    camera: Path | None,
    sheet: Sequence[str],
    axis: Sequence[str],
    refine: Sequence[Part],
    lens: CameraModel = "pinhole",
) -> tuple[KnownParts, list[str]]:
    """The parts that are given, for the rig of a capture, and a note on how the camera was read.

    Args:
        capture: Any capture of the rig.
        camera: File of a camera.
        sheet: A calibration file; or a b c d of the plane a X + b Y + c Z = d [d in m] of each laser.
        axis: A calibration file; or a point [m] and a direction, or of a linear stage the direction alone.
        refine: Parts that are estimated from there.
        lens: Model of a camera file that names none.

    Raises:
        OptionError: If numbers are missing or mean nothing, or a part is to be refined that is not given.
        CalibrationError: If a file is wrong, or lacks the part.
    """
    given = {"camera": camera, "sheet": sheet, "axis": axis}
    for part in refine:
        if not given[part]:
            raise OptionError(f"--refine {part}: --{part} is missing, which gives the values to start from.")
    read = None if camera is None else _camera(camera, capture.image_size, lens)
    known = KnownParts(
        camera=None if read is None else read.camera,
        sheets=_sheets(sheet, [line.name for line in capture.lasers]),
        motion=_motion(axis, capture.carries or "scanner") if axis else None,
        refine=tuple(refine),
    )
    return known, [] if read is None or not read.note else [read.note]


def known_files(sheet: Sequence[str], axis: Sequence[str]) -> list[tuple[str, Path]]:
    """The files among them, each with its option."""
    both = (("--sheet", sheet), ("--axis", axis))
    return [(option, Path(words[0])) for option, words in both if _is_file(words)]


def motion_notes(capture: Capture, axis: Sequence[str]) -> list[str]:
    """A note on the motion that a known axis is taken for, where the capture names none."""
    if not axis or _is_file(axis) or capture.carries is not None:
        return []
    return [
        f"{capture.path}: does not say what the table carries, so --axis is that of a table that carries the scanner; "
        'otherwise write into its capture.toml: [turntable] carries = "object".'
    ]


def _is_file(words: Sequence[str]) -> bool:
    return len(words) == 1 and words[0].lower().endswith(".json")


def _camera(path: Path, size: tuple[int, int], lens: CameraModel) -> ReadCamera:
    read = read_camera(path, size, unnamed="fisheye" if lens == "fisheye" else "pinhole")
    if lens not in ("pinhole", read.camera.model):
        raise OptionError(f"--lens {lens}: {path} holds a {read.camera.model} camera; leave out --lens, or --camera.")
    return read


def _sheets(words: Sequence[str], names: Sequence[str]) -> tuple[LaserSheet, ...]:
    if not words:
        return ()
    if _is_file(words):
        scanner = load_parts(words[0])[1]
        if scanner is None or not scanner.laser_names:
            raise OptionError(f"--sheet: {words[0]} holds no laser sheet, expected a calibration with one.")
        known = scanner.laser_names
        if set(names) <= set(known):
            return tuple(scanner.laser(known.index(name)) for name in names)
        if len(known) > 1:
            raise OptionError(
                f"--sheet: {words[0]} has the lasers {', '.join(known)}, the capture {', '.join(names) or 'none'}; "
                "give the planes as numbers, in the order of the capture's lasers."
            )
        return (scanner.laser(0),)
    values = _numbers("--sheet", words, 4 * max(len(names), 1), "a b c d of the plane a X + b Y + c Z = d")
    try:
        return tuple(LaserSheet.from_plane(plane[:3], plane[3]) for plane in values.reshape(-1, 4))
    except ValueError as problem:
        raise OptionError(f"--sheet: {problem}.") from problem


def _motion(words: Sequence[str], carries: str) -> AbstractMotion:
    if _is_file(words):
        scanner = load_parts(words[0])[1]
        if scanner is None or isinstance(scanner.turntable, Still):
            raise OptionError(f"--axis: {words[0]} holds no axis, expected a calibration with one.")
        return scanner.turntable
    linear = carries == "linear"
    wanted = "the direction of travel" if linear else "a point of the axis in metres and its direction"
    values = _numbers("--axis", words, 3 if linear else 6, wanted)
    try:
        if linear:
            return LinearStage.from_direction(values)
        return Turntable.from_axis(values[3:], values[:3], carries="object" if carries == "object" else "scanner")
    except ValueError as problem:
        raise OptionError(f"--axis: {problem}.") from problem


def _numbers(option: str, words: Sequence[str], count: int, meaning: str) -> np.ndarray:
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise OptionError(
            f"{option}: found {' '.join(words)[:60]}, expected {count} numbers ({meaning}) or a calibration (.json)."
        )
    return values
