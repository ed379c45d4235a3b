"""The journal of a capture: `frames.jsonl`, one JSON object per completed record."""

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import pydantic

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import record_position
from jaxscan.files.capture.references import MAX_IMAGES, ImageRef, is_plain, parse_images, with_digests
from jaxscan.files.disk import MAX_DEPTH, Integer, Number, check, is_deep, too_deep
from jaxscan.geometry import Carries


JOURNAL_NAME = "frames.jsonl"
MAX_JOURNAL_BYTES = 256 << 20
MAX_LINE_BYTES = 64 << 10
MAX_RECORDS = 1_000_000
MAX_LINES = 2_000_000

_MAX_NUMBER = 1 << 53
_MAX_ANGLE = 1e6
_MAX_POSITION_M = 1e4
_MAX_PLACEMENT = 1 << 31
_MAX_LASERS = 64
_MISSING = object()
_OF_RECORDS = {"on", "off", "angle_deg", "position_m"}
"""Keys that events do not have, unless they say so by the key `event`."""


@dataclass(frozen=True, slots=True)
class Record:
    """One completed record."""

    i: int
    """Its own number."""
    angle: float | None
    """The table's angle [rad from home], or the position of a linear stage [m]; None where unknown."""
    placement: int | None
    """Which pose of the board it saw, in a calibration capture."""
    lasers: tuple[int, ...]
    """Indices of the lasers lit in the `on` frame, in the header's order; empty without one."""
    on: tuple[ImageRef, ...]
    """Images of the laser-on frame: one, or several with exposures; empty without one."""
    off: tuple[ImageRef, ...]


class Journal(NamedTuple):
    """The contents of a journal."""

    records: tuple[Record, ...]
    """One per number, in the order of the numbers."""
    notes: tuple[str, ...]
    """A sentence for each line that was dropped."""
    takes: dict[int, int]
    """How many lines each record has."""


class _Line(pydantic.BaseModel):
    # Acquisition adds keys of its own to a record, and may add more.
    model_config = pydantic.ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    i: Annotated[Integer, pydantic.Field(ge=0, lt=_MAX_NUMBER)]
    # No table turns a million degrees, and squares and sums of such angles are finite.
    angle_deg: Annotated[Number, pydantic.Field(ge=-_MAX_ANGLE, le=_MAX_ANGLE)] | None = None
    position_m: Annotated[Number, pydantic.Field(ge=-_MAX_POSITION_M, le=_MAX_POSITION_M)] | None = None
    placement: Annotated[Integer, pydantic.Field(ge=0, lt=_MAX_PLACEMENT)] | None = None
    lasers: Annotated[list[Integer | str], pydantic.Field(max_length=_MAX_LASERS)] | None = None
    on: Annotated[Any, pydantic.AfterValidator(parse_images)] = ()
    off: Annotated[Any, pydantic.AfterValidator(parse_images)] = ()
    sha256: Any = None


class _Fields(NamedTuple):
    """The checked fields of a record's line, which is the `number`-th of the file."""

    number: int
    angle_deg: float | None
    position_m: float | None
    placement: int | None
    lasers: list[int | str] | None
    on: Any
    """A reference as text, or images."""
    off: Any
    digests: dict[str, Any]
    """Of `on` and `off`, each a text, a list of them or None."""


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
        name: Name of the file, for messages.
        kind: Kind of the capture: a sweep needs angles and `on` images, a calibration may lack them.
        laser_names: The lasers in the header's order.
        carries: The kind of motion: records of a linear stage have positions in place of angles, those of a scanner
            that stands still may have neither.

    Raises:
        CaptureError: With the number of the line that is broken or not a record.
    """
    latest: dict[int, _Fields] = {}
    takes: dict[int, int] = {}
    torn = ""
    if (lines := data.count(b"\n")) > MAX_LINES:
        raise CaptureError(f"{name}: found {lines} lines, expected at most {MAX_LINES}; split the capture.")
    for number, line in enumerate(io.BytesIO(data), 1):
        if torn and line.strip():
            raise CaptureError(f"{torn}; repair or remove this line, it is not the last.")
        value = _parse(line, name, number)
        if value is None:
            if line.strip():
                torn = f"{name}: line {number}: not a complete JSON object"
            continue
        if (i := value.get("i", _MISSING)) is _MISSING:
            _check_event(value, name, number)
            continue
        latest[i] = _fields(value, number) or _fields_slowly(value, name, number)
        takes[i] = takes.get(i, 0) + 1
        if len(latest) > MAX_RECORDS:
            raise CaptureError(f"{name}: line {number}: more than {MAX_RECORDS} records; split the capture.")
    records = tuple(_complete(i, latest.pop(i), name, kind, (laser_names, carries)) for i in sorted(latest))
    return Journal(records, (f"{torn}: the last line was cut off and is left out.",) if torn else (), takes)


def _fields(value: dict[str, Any], number: int) -> _Fields | None:
    """The fields of a record as most are; None if the slower check, which has the messages, must decide.

    A journal may have a million lines.
    """
    angle, placement, lasers = value.get("angle_deg"), value.get("placement"), value.get("lasers")
    on, off, position = value.get("on"), value.get("off"), value.get("position_m")
    usual = (
        type(value["i"]) is int
        and 0 <= value["i"] < _MAX_NUMBER
        and (angle is None or (type(angle) is float and -_MAX_ANGLE <= angle <= _MAX_ANGLE))
        and (position is None or (type(position) is float and -_MAX_POSITION_M <= position <= _MAX_POSITION_M))
        and (placement is None or (type(placement) is int and 0 <= placement < _MAX_PLACEMENT))
        and (
            lasers is None
            or (type(lasers) is list and len(lasers) <= _MAX_LASERS and all(type(one) is str for one in lasers))
        )
        and (on is None or (type(on) is str and is_plain(on)))
        and (off is None or (type(off) is str and is_plain(off)))
    )
    return (
        _Fields(number, angle, position, placement, lasers, on, off, _digests(value.get("sha256"))) if usual else None
    )


def _fields_slowly(value: dict[str, Any], name: str, number: int) -> _Fields:
    line = check(_Line, value, name=f"{name}: line {number}", error=CaptureError)
    return _Fields(
        number, line.angle_deg, line.position_m, line.placement, line.lasers, line.on, line.off, _digests(line.sha256)
    )


def _digests(given: Any) -> dict[str, Any]:
    """The digests of both sides, and nothing beside them that takes memory; anything else as a short text."""
    if given is None:
        return {}
    sides = given if isinstance(given, dict) else dict.fromkeys(("on", "off"), given)
    return {side: _short(sides[side]) for side in ("on", "off") if side in sides}


def _short(digests: Any) -> Any:
    if isinstance(digests, list):
        return [one if isinstance(one, str) else repr(one)[:64] for one in digests[:MAX_IMAGES]]
    return digests if digests is None or isinstance(digests, str) else repr(digests)[:64]


def _check_event(value: dict[str, Any], name: str, number: int) -> None:
    """Refuse a record whose number is misspelt, which would be taken for an event and skipped."""
    if "event" not in value and (found := _OF_RECORDS & value.keys()):
        raise CaptureError(
            f"{name}: line {number}: i: missing, although {', '.join(sorted(found))} stand there; expected the number "
            "of the record."
        )


def journal_line(fields: dict[str, Any], *, name: str) -> bytes:
    """The line of a record or an event, which readers accept.

    Args:
        fields: JSON values.
        name: Name of the capture, for messages.

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
            value = None  # A torn last line; any other was refused before.
        if isinstance(value, dict):
            yield start, value
        start += len(line) + 1


def _parse(line: bytes, name: str, number: int) -> dict[str, Any] | None:
    """The object of a line; None if the line is torn or empty."""
    if len(line) > MAX_LINE_BYTES:
        raise CaptureError(f"{name}: line {number}: longer than {MAX_LINE_BYTES >> 10} KiB, so it is no record.")
    try:
        value = json.loads(line.decode("utf-8"))
    except RecursionError:
        raise CaptureError(too_deep(f"{name}: line {number}")) from None
    except ValueError:
        return None
    if not isinstance(value, dict):
        raise CaptureError(f"{name}: line {number}: found {str(value)[:40]}, expected a JSON object.")
    if _may_be_deep(line) and is_deep(value):
        raise CaptureError(too_deep(f"{name}: line {number}"))
    return value


def _may_be_deep(line: bytes) -> bool:
    # Few lines have so many brackets.
    return line.count(b"{") + line.count(b"[") > MAX_DEPTH


def _complete(i: int, line: _Fields, name: str, kind: str, rig: tuple[tuple[str, ...], Carries]) -> Record:
    laser_names, carries = rig
    position = record_position(line.angle_deg, line.position_m, (kind, carries), where=f"{name}: line {line.number}")
    if kind == "sweep":
        if not line.on:
            raise CaptureError(
                f"{name}: line {line.number}: on: found null, but a sweep needs a laser-on image in every record."
            )
    elif not line.on and not line.off:
        raise CaptureError(f"{name}: line {line.number}: on, off: both are null; a record needs an image.")
    on, off = (parse_images(given) if given is None or type(given) is str else given for given in (line.on, line.off))
    return Record(
        i=i,
        angle=position,
        placement=line.placement,
        lasers=() if not on else _lit(line.lasers, f"{name}: line {line.number}", laser_names),
        on=with_digests(on, line.digests.get("on")),
        off=with_digests(off, line.digests.get("off")),
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
