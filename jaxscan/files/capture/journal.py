"""The journal of a capture: `frames.jsonl`, one JSON object per completed record."""

import io
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pydantic

from jaxscan.errors import CaptureError
from jaxscan.files.capture.references import ImageRef, parse_images, with_digests
from jaxscan.files.disk import Integer, Number, check


JOURNAL_NAME = "frames.jsonl"
MAX_JOURNAL_BYTES = 256 << 20
MAX_LINE_BYTES = 64 << 10
MAX_RECORDS = 1_000_000


@dataclass(frozen=True)
class Record:
    """One completed record."""

    i: int
    """Its own number."""
    angle: float | None
    """The table's angle [rad from home]; None where unknown."""
    placement: int | None
    """Which pose of the board it saw, in a calibration capture."""
    lasers: tuple[int, ...]
    """Indices of the lasers lit in the `on` frame, in the header's order; empty without one."""
    on: tuple[ImageRef, ...]
    """Images of the laser-on frame: one, or several with exposures; empty without one."""
    off: tuple[ImageRef, ...]


class _Line(pydantic.BaseModel):
    # Acquisition adds keys of its own to a record, and may add more.
    model_config = pydantic.ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    i: Annotated[Integer, pydantic.Field(ge=0, lt=1 << 53)]
    # No table turns a million degrees, and squares and sums of such angles are finite.
    angle_deg: Annotated[Number, pydantic.Field(ge=-1e6, le=1e6)] | None = None
    placement: Annotated[Integer, pydantic.Field(ge=0, lt=1 << 31)] | None = None
    lasers: list[Integer | str] | None = None
    on: Annotated[Any, pydantic.AfterValidator(parse_images)] = ()
    off: Annotated[Any, pydantic.AfterValidator(parse_images)] = ()
    sha256: Any = None


def read_journal(
    data: bytes, *, name: str, kind: Literal["sweep", "calibration"], laser_names: tuple[str, ...]
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """The records of a journal, in the order of their numbers.

    A torn last line, which a crash leaves behind, is dropped; of several complete records with
    the same number the last wins; objects without a number are events and are skipped.

    Args:
        data: The whole file.
        name: Name of the file, for messages.
        kind: Kind of the capture: a sweep needs angles and `on` images, a calibration may lack them.
        laser_names: The lasers in the header's order.

    Returns:
        records: One per number.
        notes: A sentence for each line that was dropped.

    Raises:
        CaptureError: With the number of the line that is broken or not a record.
    """
    latest: dict[int, tuple[str, _Line]] = {}
    torn = ""
    for number, line in enumerate(io.BytesIO(data), 1):
        if not line.strip():
            continue
        if torn:
            raise CaptureError(f"{torn}; repair or remove this line, it is not the last.")
        where = f"{name}: line {number}"
        value = _parse(line, where)
        if value is None:
            torn = f"{where}: not a complete JSON object"
        if value is None or "i" not in value:
            continue
        record = check(_Line, value, name=where, error=CaptureError)
        latest[record.i] = (where, record)
        if len(latest) > MAX_RECORDS:
            raise CaptureError(f"{where}: more than {MAX_RECORDS} records; split the capture.")
    records = [_complete(latest[i][1], latest[i][0], kind, laser_names) for i in sorted(latest)]
    return tuple(records), (f"{torn}: the last line was cut off and is left out.",) if torn else ()


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


def _parse(line: bytes, where: str) -> dict[str, Any] | None:
    """The object of a line; None if the line is torn."""
    if len(line) > MAX_LINE_BYTES:
        raise CaptureError(f"{where}: longer than {MAX_LINE_BYTES >> 10} KiB, so it is no record.")
    try:
        value = json.loads(line.decode("utf-8"))
    except RecursionError:
        raise CaptureError(f"{where}: nested too deeply to be a record.") from None
    except ValueError:
        return None
    if not isinstance(value, dict):
        raise CaptureError(f"{where}: found {str(value)[:40]}, expected a JSON object.")
    return value


def _complete(line: _Line, where: str, kind: str, laser_names: tuple[str, ...]) -> Record:
    if kind == "sweep":
        if line.angle_deg is None:
            raise CaptureError(f"{where}: angle_deg: found null, but a sweep needs the angle of every record.")
        if not line.on:
            raise CaptureError(f"{where}: on: found null, but a sweep needs a laser-on image in every record.")
    elif not line.on and not line.off:
        raise CaptureError(f"{where}: on, off: both are null; a record needs an image.")
    digests = line.sha256 if isinstance(line.sha256, dict) else dict.fromkeys(("on", "off"), line.sha256)
    return Record(
        i=line.i,
        angle=None if line.angle_deg is None else math.radians(line.angle_deg),
        placement=line.placement,
        lasers=() if not line.on else _lit(line.lasers, where, laser_names),
        on=with_digests(line.on, digests.get("on")),
        off=with_digests(line.off, digests.get("off")),
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
