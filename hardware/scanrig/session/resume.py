"""Reads an interrupted capture, and checks whether it may be continued."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import pydantic

from jaxscan.errors import CaptureError
from jaxscan.files.capture import CaptureHeader, ImageReader, Problem, journal_objects, read_texts, verify_capture
from scanrig.config import RigConfig
from scanrig.errors import SessionError
from scanrig.session.job import Kind


T = TypeVar("T")
_SHOWN = 5
_RUNS = pydantic.TypeAdapter(list[Annotated[list[int], pydantic.Field(min_length=2, max_length=2)]])
_INTEGER = pydantic.TypeAdapter(int)
_NUMBER = pydantic.TypeAdapter(Annotated[int, pydantic.Field(ge=0, lt=1 << 31)])
_ACQUISITION: dict[str, pydantic.TypeAdapter[Any]] = {
    "camera": pydantic.TypeAdapter(dict[str, Any]),
    "features": pydantic.TypeAdapter(dict[str, int | float | str]),
    "calibration": pydantic.TypeAdapter(Annotated[str, pydantic.Field(pattern="^[ -~]*$")]),
}
"""The values of the header that are used again."""


@dataclass(frozen=True)
class Found:
    """A capture as an earlier session left it."""

    header: CaptureHeader
    records: dict[int, dict[str, Any]]
    """Whole records that are not suspect, in the order in which they were taken; of each the last take."""
    since_home: tuple[int, ...]
    """Records taken since home was last found well."""
    unjudged: bool
    """Whether home was found after these records without a valid counter, so that lost steps would not show."""
    damaged: tuple[Problem, ...]
    altered: tuple[Problem, ...]
    suspect: tuple[int, ...]
    """Records that may have lost steps before them, and were not retaken since."""
    placements: int
    """Placements of a calibration's board so far, including half done ones."""
    status: str | None
    """How the last session ended, if it noted an end after its last record."""


def find_capture(folder: Path, *, progress: Callable[[int, int], None] | None = None) -> Found:
    """Read and verify a whole capture; `progress` is called with (records done, records in all).

    Raises:
        CaptureError: If header or journal are damaged in a way that no interruption causes.
        SessionError: If the journal holds values that no session writes.
    """
    texts = read_texts(folder)
    problems = verify_capture(folder, progress=progress)
    records: dict[int, dict[str, Any]] = {}
    since_home: list[int] = []
    suspect: set[int] = set()
    placements, status, unjudged = 0, None, False
    for _, value in journal_objects(texts.journal_bytes):
        if "i" in value:
            number, status = value["i"], None
            records.pop(number, None)  # Keeps the order of the last takes.
            records[number] = value
            since_home.append(number)
            suspect.discard(number)
            placement = value.get("placement")
            placements = max(placements, 0 if placement is None else 1 + placement)
            continue
        match value.get("event"):
            case "home" if value.get("good") is False:
                # The session may have ended before it noted these records as suspect.
                suspect.update(since_home)
                since_home.clear()
                unjudged = False
            case "home" if value.get("good") is not True:
                unjudged = bool(since_home)
            case "home" if not unjudged:
                since_home.clear()
            case "compared" if value.get("good") is True:
                since_home.clear()
                unjudged = False
            case "suspect":
                runs = _checked(folder, "the records of an event", value.get("records"), _RUNS)
                suspect.update(n for n in records if any(first <= n <= last for first, last in runs))
            case "placed":
                placed = _checked(folder, "the placement of an event", value.get("placement"), _NUMBER)
                placements = max(placements, 1 + placed)
            case "end":
                status = value.get("status")
    bad = {problem.record for problem in problems}
    whole = {number: value for number, value in records.items() if number not in bad and number not in suspect}
    return Found(
        header=texts.header,
        records=whole,
        since_home=tuple(number for number in dict.fromkeys(since_home) if number in whole),
        unjudged=unjudged,
        damaged=tuple(problem for problem in problems if problem.record is not None),
        altered=tuple(problem for problem in problems if problem.record is None),
        suspect=tuple(sorted(suspect & records.keys())),
        placements=placements,
        status=status,
    )


def _checked(folder: Path, name: str, value: Any, kind: pydantic.TypeAdapter[T]) -> T:
    """A value of header or journal, which anybody can edit."""
    try:
        return kind.validate_python(value, strict=True)
    except pydantic.ValidationError as problem:
        raise SessionError(
            f"{folder}: found {name} = {value!a:.40}, which no session writes; the capture cannot be continued."
        ) from problem


def read_pair(folder: Path, number: int) -> tuple[np.ndarray, np.ndarray]:
    """The laser-on and laser-off frame of one record in 8 bits; other records may be damaged.

    Raises:
        CaptureError: If they are missing or damaged.
    """
    texts = read_texts(folder)
    reader = ImageReader(folder, texts.header)
    for record in texts.records:
        if record.i == number:
            on, off = reader.frame(record.on), reader.frame(record.off)
            if on is not None and off is not None:
                # With more than 8 bits, the first level holds the whole range.
                return (on, off) if texts.header.camera.bits is None else (on[0], off[0])
    raise CaptureError(f"{folder}: record {number} lacks a frame, so nothing can be compared with it.")


def require_same_plan(
    found: Found, config: RigConfig, kind: Kind, *, folder: Path, calibration_digest: str | None
) -> None:
    """Check that nothing changed that the frames depend on, and that a session has written what is used again.

    Raises:
        SessionError: With the changes, or the value.
    """
    header, was = found.header, found.header.acquisition
    if header.kind != kind:
        raise SessionError(f"{folder}: found a capture of kind {header.kind}, expected {kind}; choose another folder.")
    if "config_sha256" not in was:
        raise SessionError(f"{folder}: was not captured by this program, so it cannot be continued.")
    for key, values in _ACQUISITION.items():
        if key in was:
            _checked(folder, f"acquisition.{key}", was[key], values)
    for number, record in found.records.items():
        _checked(folder, f"microsteps of record {number}", record.get("microsteps"), _INTEGER)
    now = {"config": config.frame_tables(kind), "microsteps_per_turn": config.microsteps_per_turn}
    changed = [change for key, value in now.items() for change in _changes(was.get(key), value, key)]
    before = was.get("calibration")
    if calibration_digest is not None and before is not None and before != calibration_digest:
        changed.append(f"calibration: was {before[:19]}…, is {calibration_digest[:19]}…")
    if not changed and was["config_sha256"] != config.digest(kind):
        changed.append("the configuration's digest")
    if changed:
        more = [f"and {len(changed) - _SHOWN} more"] if len(changed) > _SHOWN else []
        raise SessionError(
            f"{folder}: cannot be continued, since it was begun with other settings: "
            f"{'; '.join(changed[:_SHOWN] + more)}. Restore them, or choose another folder."
        )


def require_same_camera(found: Found, identity: Mapping[str, str], *, folder: Path) -> None:
    """Check that it is the camera with which the capture was begun.

    Raises:
        SessionError: With both cameras.
    """
    if changed := list(_changes(found.header.acquisition.get("camera", {}), identity)):
        raise SessionError(
            f"{folder}: was begun with another camera ({'; '.join(changed)}); "
            "connect that one, or choose another folder."
        )


def _changes(was: Any, now: Any, path: str = "") -> Iterator[str]:
    """Keys whose values differ, with both values."""
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys((*was, *now)):
            yield from _changes(was.get(key), now.get(key), f"{path}.{key}" if path else str(key))
    elif _is_list(was) and _is_list(now) and len(was) == len(now):
        for number, (one, other) in enumerate(zip(was, now, strict=True)):
            yield from _changes(one, other, f"{path}[{number}]")
    elif was != now:
        name = path.removeprefix("config.")
        yield f"{name if name.isprintable() else ascii(name):.60}: was {_shown(was)}, is {_shown(now)}"


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _shown(value: Any) -> str:
    """A value as people read it, cut: it may be of any length and kind in a file that others may edit."""
    return "not given" if value is None else f"{json.dumps(value, default=str):.60}"


def ranges(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of each run of consecutive numbers, ascending."""
    runs: list[tuple[int, int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][1] + 1:
            runs[-1] = (runs[-1][0], number)
        else:
            runs.append((number, number))
    return runs
