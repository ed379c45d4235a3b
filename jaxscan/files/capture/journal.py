"""The journal of a capture: `frames.jsonl`, one JSON object per completed record, with references to its images."""

import hashlib
import io
import json
import math
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pydantic

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import HEADER_NAME, MAX_HEADER_BYTES, CaptureHeader, parse_header
from jaxscan.files.disk import MAX_DEPTH, Integer, Number, check, is_deep, read_bounded, too_deep
from jaxscan.geometry import MOTIONS, Carries, is_pose


MAX_IMAGES = 16
"""Images that one frame of a record may list: exposures of a bracket, and repetitions to average."""


@dataclass(frozen=True, slots=True)
class ImageRef:
    """An image file, or one image of a shard (an `.npy` file of uint8 [n, rows, columns(, 3)])."""

    path: str
    """Relative to the folder of the capture, with "/" between its parts."""
    index: int | None = None
    """Which image of a shard; None for an image file."""
    exposure_s: float | None = None
    """Exposure [s]; None where the record names one image without it."""
    sha256: str | None = None
    """Digest of the file, or of the frame in a shard, in hexadecimal digits; None where the record has none."""

    def __str__(self) -> str:
        return self.path if self.index is None else f"{self.path}#{self.index}"


def parse_images(value: Any) -> tuple[ImageRef, ...]:
    """The images of one frame as they stand in a record: none, one, or a list with exposures."""
    if value is None:
        return ()
    if not isinstance(value, list):
        return (parse_reference(value),)
    if not 1 <= len(value) <= MAX_IMAGES:
        raise ValueError(f"found a list of {len(value)} images, expected 1 to {MAX_IMAGES}")
    return tuple(_exposed(one) for one in value)


def _exposed(value: Any) -> ImageRef:
    if not isinstance(value, dict) or not {"file", "exposure_s"} <= value.keys():
        raise ValueError(f'found {value!r:.60} in a list, expected {{"file": ..., "exposure_s": ...}}')
    exposure = value["exposure_s"]
    # A bool counts as an integer in Python, and an integer may be too large for a float.
    number = isinstance(exposure, int | float) and not isinstance(exposure, bool)
    if not number or not 0 < exposure <= 1e6 or not math.isfinite(1.0 / exposure):
        raise ValueError(f"exposure_s: found {exposure!r:.60}, expected a number of seconds above 0")
    return replace(parse_reference(value["file"]), exposure_s=float(exposure))


def _with_digests(images: tuple[ImageRef, ...], given: str | list[str] | None) -> tuple[ImageRef, ...]:
    """Images with the digests of their record: one text, or a list of them in the order of the images."""
    if given is None:
        return images
    texts = ([given] if isinstance(given, str) else given)[: len(images)]
    # A digest that is not a text matches no image.
    texts += ["none"] * (len(images) - len(texts))
    return tuple(replace(one, sha256=text) for one, text in zip(images, texts, strict=True))


_OF_SHARD = re.compile(r"(.*\.npy)#([0-9]{1,9})", re.DOTALL)
_CONTROL, _DRIVE = re.compile(r"[\x00-\x1f\x7f]"), re.compile(r"[A-Za-z]:")


def parse_reference(value: Any) -> ImageRef:
    """The reference to one image."""
    if not isinstance(value, str):
        raise ValueError(f"found {value!r:.60}, expected a path, null, or a list of images with exposures")
    path, index = value, None
    if match := _OF_SHARD.fullmatch(value):
        path, index = match[1], int(match[2])
    elif value.endswith(".npy"):
        raise ValueError(f'found "{value:.60}", expected "{value:.60}#<index>": which image of the shard is meant')
    if problem := _unsafe(path):
        raise ValueError(f"found {value!r:.60}, {problem}; expected a relative path inside the capture's folder")
    return ImageRef(path, index)


def _unsafe(path: str) -> str | None:
    if not path or len(path) > 1024:
        return "which is empty or too long"
    if _CONTROL.search(path):
        return "which has control characters"
    if "\\" in path:
        return 'which has a backslash (the separator is "/" everywhere)'
    if path.startswith("/") or _DRIVE.match(path):
        return "which is not relative"
    if not {"", ".", ".."}.isdisjoint(path.split("/")):
        return 'which has an empty part, "." or ".."'
    return None


class Folder:
    """Finds referenced files in the folder of a capture, and refuses all files outside it."""

    def __init__(self, root: Path) -> None:
        self._root = Path(os.path.realpath(root))
        self._inside: dict[str, bool] = {}
        self._files: dict[str, frozenset[str]] = {}

    def holds(self, path: str) -> bool:
        """Whether a path is that of a regular file inside; links, and names in other spellings, are for `locate`.

        Each folder is listed once, which is faster than looking at thousands of images one by one.
        """
        folder, _, name = path.rpartition("/")
        if folder not in self._files:
            self._files[folder] = self._list(self._root / folder)
        return name in self._files[folder]

    def _list(self, folder: Path) -> frozenset[str]:
        if not self._is_inside(folder):
            return frozenset()
        try:
            with os.scandir(folder) as entries:
                return frozenset(entry.name for entry in entries if entry.is_file(follow_symlinks=False))
        except OSError:
            return frozenset()

    def locate(self, reference: ImageRef) -> Path:
        """Path of an existing regular file, where a link inside leads to the file itself.

        Raises:
            CaptureError: If it does not exist, is no regular file, or a link leads out.
        """
        path = self._root / reference.path
        try:
            status = os.lstat(path)
            inside = self._is_inside(path.parent)
            if stat.S_ISLNK(status.st_mode):
                path = Path(os.path.realpath(path))
                inside, status = inside and self._is_inside(path), os.stat(path)
        except (OSError, ValueError) as problem:
            reason = "no such file" if isinstance(problem, FileNotFoundError) else getattr(problem, "strerror", problem)
            raise CaptureError(f"{reference.path}: {reason}.") from problem
        if not inside:
            raise CaptureError(f"{reference.path}: a link that leads out of the capture's folder; copy the file there.")
        if not stat.S_ISREG(status.st_mode):
            raise CaptureError(f"{reference.path}: found a folder, device or pipe, expected an image file.")
        return path

    def _is_inside(self, path: Path) -> bool:
        # Thousands of images share a few folders, and resolving is slow.
        key = str(path)
        if key not in self._inside:
            self._inside[key] = Path(os.path.realpath(path)).is_relative_to(self._root)
        return self._inside[key]


JOURNAL_NAME = "frames.jsonl"
MAX_JOURNAL_BYTES = 256 << 20
MAX_LINE_BYTES = 64 << 10
MAX_RECORDS = 1_000_000
MAX_LINES = 2_000_000

_OF_RECORDS = {"on", "off", "angle_deg", "position_m", "pose"}
"""Keys that events do not have, unless they say so by the key `event`."""


@dataclass(frozen=True, slots=True)
class Record:
    """One completed record."""

    i: int
    angle: float | None
    """The table's angle [rad from home], or the position of a linear stage [m]; None where unknown."""
    placement: int | None
    """Which pose of the board it saw, in a calibration capture."""
    lasers: tuple[int, ...]
    """Indices of the lasers lit in the `on` frame, in the header's order; empty without one."""
    on: tuple[ImageRef, ...]
    off: tuple[ImageRef, ...]
    pose: tuple[float, ...] | None = None
    """T_base_hand as twelve numbers, row after row [m], where poses are given; `angle` is then the record's place among
    all."""


class Journal(NamedTuple):
    """The contents of a journal."""

    records: tuple[Record, ...]
    notes: tuple[str, ...]
    takes: dict[int, int]


def _digests(given: Any) -> dict[str, Any] | None:
    """The digests of both sides. Anything else is cut to a short text, so that it takes no memory."""
    if given is None:
        return None
    sides = given if isinstance(given, dict) else dict.fromkeys(("on", "off"), given)
    return {side: _short(sides[side]) for side in ("on", "off") if side in sides}


def _short(digests: Any) -> Any:
    if isinstance(digests, list):
        return [one if isinstance(one, str) else repr(one)[:64] for one in digests[:MAX_IMAGES]]
    return digests if digests is None or isinstance(digests, str) else repr(digests)[:64]


_Twelve = Annotated[list[Number], pydantic.Field(min_length=12, max_length=12)]


def _rigid(numbers: list[float]) -> list[float]:
    if not is_pose(np.vstack([np.reshape(numbers, (3, 4)), [0.0, 0.0, 0.0, 1.0]])):
        raise ValueError("found no rigid motion, expected the three upper rows of T_base_hand, one after another, in m")
    return numbers


class _Line(pydantic.BaseModel):
    # Acquisition adds keys of its own to a record, and may add more.
    model_config = pydantic.ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    i: Annotated[Integer, pydantic.Field(ge=0, lt=1 << 53)]
    # No table turns a million degrees, and squares and sums of such angles are finite.
    angle_deg: Annotated[Number, pydantic.Field(ge=-1e6, le=1e6)] | None = None
    position_m: Annotated[Number, pydantic.Field(ge=-1e4, le=1e4)] | None = None
    pose: Annotated[_Twelve, pydantic.AfterValidator(_rigid)] | None = None
    placement: Annotated[Integer, pydantic.Field(ge=0, lt=1 << 31)] | None = None
    lasers: Annotated[list[Integer | str], pydantic.Field(max_length=64)] | None = None
    on: Annotated[Any, pydantic.AfterValidator(parse_images)] = ()
    off: Annotated[Any, pydantic.AfterValidator(parse_images)] = ()
    sha256: Annotated[Any, pydantic.AfterValidator(_digests)] = None


def read_journal(
    data: bytes,
    *,
    name: str,
    kind: Literal["sweep", "calibration"],
    laser_names: tuple[str, ...],
    carries: Carries = "scanner",
) -> Journal:
    """The records of a journal, in the order of their numbers.

    A torn last line, which a crash leaves behind, is dropped; of several complete records with
    the same number the last wins; objects without a number are events and are skipped.

    Args:
        data: The whole file.
        kind: Kind of the capture: a sweep needs angles and `on` images, a calibration may lack them.
        laser_names: The lasers in the header's order.
        carries: The kind of motion: records of a linear stage have positions in place of angles, those of a scanner
            that stands still may have neither.
    """
    latest: dict[int, Record] = {}
    takes: dict[int, int] = {}
    torn = ""
    if (lines := data.count(b"\n")) > MAX_LINES:
        raise CaptureError(f"{name}: found {lines} lines, expected at most {MAX_LINES}; split the capture.")
    for number, text in enumerate(io.BytesIO(data), 1):
        if torn and text.strip():
            raise CaptureError(f"{torn}; repair or remove this line, it is not the last.")
        where = f"{name}: line {number}"
        value = _parse(text, where)
        if value is None:
            torn = f"{where}: not a complete JSON object" if text.strip() else torn
            continue
        if "i" not in value:
            _check_event(value, where)
            continue
        line = check(_Line, value, name=where, error=CaptureError)
        latest[line.i] = _record(line, where, kind, laser_names, carries)
        takes[line.i] = takes.get(line.i, 0) + 1
        if len(latest) > MAX_RECORDS:
            raise CaptureError(f"{where}: more than {MAX_RECORDS} records; split the capture.")
    notes = (f"{torn}: the last line was cut off and is left out.",) if torn else ()
    records = [latest[i] for i in sorted(latest)]
    if MOTIONS[carries].unit == "pose":
        records = [replace(one, angle=None if one.pose is None else float(at)) for at, one in enumerate(records)]
    return Journal(tuple(records), notes, takes)


def _check_event(value: dict[str, Any], where: str) -> None:
    """Refuse a record whose number is misspelt, which would be taken for an event and skipped."""
    if "event" not in value and (found := _OF_RECORDS & value.keys()):
        raise CaptureError(
            f"{where}: i: missing, although {', '.join(sorted(found))} stand there; expected the number of the record."
        )


def journal_line(fields: dict[str, Any], *, name: str) -> bytes:
    """The line of a record or an event, which readers accept.

    Args:
        fields: JSON values.

    Raises:
        CaptureError: If it holds something else, is too long or is nested too deeply.
    """
    try:
        line = json.dumps(fields, allow_nan=False).encode() + b"\n"
    except RecursionError as problem:
        raise CaptureError(too_deep(name)) from problem
    except (TypeError, ValueError) as problem:
        raise CaptureError(f"{name}: {problem}: a record holds only JSON values.") from problem
    if len(line) > MAX_LINE_BYTES:
        raise CaptureError(f"{name}: a record of {len(line)} bytes, more than {MAX_LINE_BYTES}.")
    if _may_be_deep(line) and is_deep(json.loads(line)):
        raise CaptureError(too_deep(name))
    return line


def journal_objects(journal: bytes) -> Iterator[tuple[int, dict[str, Any]]]:
    """The complete lines of a journal that `read_journal` has accepted, events too.

    Yields:
        start: Where in the file the line begins [bytes].
        value: The object that it holds.
    """
    start = 0
    for line in journal.split(b"\n"):
        try:
            value = json.loads(line) if line.strip() else None
        except ValueError:
            value = None  # A torn last line; one in the middle was refused before.
        if isinstance(value, dict):
            yield start, value
        start += len(line) + 1


def _parse(line: bytes, where: str) -> dict[str, Any] | None:
    """The object of a line; None if the line is torn or empty."""
    if len(line) > MAX_LINE_BYTES:
        raise CaptureError(f"{where}: longer than {MAX_LINE_BYTES >> 10} KiB, so it is no record.")
    try:
        value = json.loads(line.decode("utf-8"))
    except RecursionError:
        raise CaptureError(too_deep(where)) from None
    except ValueError:
        return None
    if not isinstance(value, dict):
        raise CaptureError(f"{where}: found {str(value)[:40]}, expected a JSON object.")
    if _may_be_deep(line) and is_deep(value):
        raise CaptureError(too_deep(where))
    return value


def _may_be_deep(line: bytes) -> bool:
    # Few lines have so many brackets.
    return line.count(b"{") + line.count(b"[") > MAX_DEPTH


def _record(line: _Line, where: str, kind: str, laser_names: tuple[str, ...], carries: Carries) -> Record:
    position = _position(line, kind, carries, where)
    if kind == "sweep" and not line.on:
        raise CaptureError(f"{where}: on: found null, but a sweep needs a laser-on image in every record.")
    if not line.on and not line.off:
        raise CaptureError(f"{where}: on, off: both are null; a record needs an image.")
    digests = line.sha256 or {}
    return Record(
        i=line.i,
        angle=position,
        placement=line.placement,
        lasers=() if not line.on else _lit(line.lasers, where, laser_names),
        on=_with_digests(line.on, digests.get("on")),
        off=_with_digests(line.off, digests.get("off")),
        pose=None if line.pose is None or MOTIONS[carries].unit != "pose" else tuple(line.pose),
    )


def _position(line: _Line, kind: str, carries: Carries, where: str) -> float | None:
    """The table's angle [rad], or the position of a stage [m]; None where none is needed and none is given."""
    if MOTIONS[carries].unit == "pose":
        if kind == "sweep" and line.pose is None:
            raise CaptureError(f"{where}: pose: found null, but a sweep with given poses needs that of every record.")
        return None
    linear = MOTIONS[carries].unit == "m"
    wanted, found = (line.position_m, line.angle_deg) if linear else (line.angle_deg, line.position_m)
    if wanted is not None:
        return wanted if linear else math.radians(wanted)
    key, other = ("position_m", "angle_deg") if linear else ("angle_deg", "position_m")
    if found is not None and carries != "nothing":
        raise CaptureError(f'{where}: {key}: missing beside {other}, expected with carries = "{carries}".')
    if kind != "sweep" or carries == "nothing":
        return None
    more = "" if linear else '; of a scanner that stands still, say carries = "nothing" under [turntable]'
    raise CaptureError(
        f"{where}: {key}: found null, but a sweep needs the {'position' if linear else 'angle'} of every record{more}."
    )


def _lit(lasers: list[int | str] | None, where: str, laser_names: tuple[str, ...]) -> tuple[int, ...]:
    """Indices of the lasers that are lit; the journal gives names or indices, and without either all are lit."""
    lit: set[int] = set()
    known = ", ".join(laser_names) or "none in the header"
    for one in range(len(laser_names)) if lasers is None else lasers:
        if isinstance(one, str) and one in laser_names:
            lit.add(laser_names.index(one))
        elif isinstance(one, int) and 0 <= one < len(laser_names):
            lit.add(one)
        else:
            raise CaptureError(f"{where}: lasers: found {one!r:.60}, expected names of lasers ({known}).")
    if not lit:
        raise CaptureError(f"{where}: lasers: none is lit in the laser-on image, expected at least one of: {known}.")
    return tuple(sorted(lit))


class CaptureTexts(NamedTuple):
    """Header and journal of a capture, as bytes and parsed."""

    header: CaptureHeader
    records: tuple[Record, ...]
    notes: tuple[str, ...]
    takes: dict[int, int]
    header_bytes: bytes
    journal_bytes: bytes

    def digest(self) -> str:
        """The sha256 of both files, as "sha256:<hex>"."""
        digest = hashlib.sha256(self.header_bytes)
        digest.update(self.journal_bytes)
        return "sha256:" + digest.hexdigest()


def read_texts(folder: Path) -> CaptureTexts:
    """Read header and journal.

    Raises:
        CaptureError: With the file, and the line or key, that is missing or wrong.
    """
    header_path, journal_path = folder / HEADER_NAME, folder / JOURNAL_NAME
    header_bytes = read_bounded(header_path, MAX_HEADER_BYTES, error=CaptureError, links="refuse")
    header = parse_header(header_bytes, name=str(header_path))
    journal_bytes = read_bounded(journal_path, MAX_JOURNAL_BYTES, error=CaptureError, links="refuse")
    names = tuple(laser.name for laser in header.laser)
    carries = "scanner" if header.turntable is None else header.turntable.carries
    journal = read_journal(journal_bytes, name=str(journal_path), kind=header.kind, laser_names=names, carries=carries)
    return CaptureTexts(header, *journal, header_bytes, journal_bytes)
