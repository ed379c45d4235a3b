"""Seals and digests: how a change of a capture since it was written is noticed.

A record holds the sha256 of its images. A seal, at the end of the journal, holds those of the journal before it and of
the header, and the number of records. A change of an image therefore needs a change of the journal, and of the seal.
"""

import hashlib
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import HEADER_NAME
from jaxscan.files.capture.journal import JOURNAL_NAME, MAX_JOURNAL_BYTES, CaptureTexts, ImageRef, journal_objects
from jaxscan.files.disk import MEGABYTE, read_bounded


SEAL = "journal_sha256"
"""Key of an event: the sha256 of the journal's bytes before the line of the event."""
HEADER_SEAL = "header_sha256"
"""Key of the same event: the sha256 of the header's bytes; older seals lack it."""
SEALED_RECORDS = "sealed_records"
"""Key of the same event: number of records before it, retakes counted once; older seals lack it."""


class Sealing(NamedTuple):
    """How well a capture is sealed."""

    broken: tuple[str, ...]
    note: str
    """The part of the journal that no seal covers although its records have digests; "" if there is none."""
    sealed: bool


def seal(path: Path) -> dict[str, Any]:
    """The fields of the event that seals a capture as it is now.

    Raises:
        CaptureError: If header or journal cannot be read.
    """
    header = read_bounded(path / HEADER_NAME, MEGABYTE, error=CaptureError, links="refuse")
    journal = read_bounded(path / JOURNAL_NAME, MAX_JOURNAL_BYTES, error=CaptureError, links="refuse")
    numbers = {value["i"] for _, value in journal_objects(journal) if "i" in value}
    return {
        SEAL: hashlib.sha256(journal).hexdigest(),
        HEADER_SEAL: hashlib.sha256(header).hexdigest(),
        SEALED_RECORDS: len(numbers),
    }


def sealing(texts: CaptureTexts, folder: Path) -> Sealing:
    """Compare header and journal with all seals of the journal."""
    journal, name = texts.journal_bytes, folder / JOURNAL_NAME
    broken: list[str] = []
    last = -1
    sealed, at = hashlib.sha256(), 0
    header, counted = hashlib.sha256(texts.header_bytes).hexdigest(), None
    line = 1
    for start, value in _seals(journal):
        sealed.update(memoryview(journal)[at:start])
        line += journal.count(b"\n", at, start)
        last = at = start
        counted = value.get(SEALED_RECORDS)
        if sealed.hexdigest() != value[SEAL]:
            broken.append(f"{name}: line {line}: the seal does not fit the lines before it.")
        if value.get(HEADER_SEAL, header) != header:
            broken.append(f"{folder / HEADER_NAME}: does not fit the seal in line {line} of {JOURNAL_NAME}.")
    after = sum("i" in value for _, value in journal_objects(journal[last:])) if last >= 0 else len(texts.records)
    if not after and counted not in (None, len(texts.records)):
        broken.append(f"{name}: found {len(texts.records)} records, its last seal counted {counted!r:.20}.")
    digests = any(image.sha256 is not None for record in texts.records for image in (*record.on, *record.off))
    note = ""
    if last >= 0 and after:
        note = f"{name}: not sealed: {after} records after the last seal; the scan was not ended after them."
    elif last < 0 and digests:
        note = (
            f"{name}: not sealed, although its records have digests: the scan goes on, was not ended, or the end "
            "was removed; a change of an angle or of the header would not be noticed."
        )
    return Sealing(tuple(broken), note, last >= 0 and not after)


def require_whole(state: Sealing) -> None:
    """Check that no seal is broken."""
    if state.broken:
        raise CaptureError(
            f"{state.broken[0].removesuffix('.')}; the file has changed since it was written: restore it from a copy, "
            f"or, if the change is meant, remove the lines with {SEAL} from {JOURNAL_NAME}."
        )


def frame_digest(frame: np.ndarray) -> str:
    """The sha256 of a frame in a shard, in hexadecimal digits."""
    # Hashed as it lies in memory, without a copy where its rows follow each other.
    return hashlib.sha256(np.ascontiguousarray(frame).reshape(-1).data).hexdigest()


def difference(image: ImageRef, found: str) -> str | None:
    """How the digest of an image differs from that in its record; None if they agree or the record has none."""
    if image.sha256 is None:
        return None
    if not re.fullmatch("[0-9a-f]{64}", image.sha256):
        return f"found {image.sha256!a:.40} in its record, expected a sha256"
    return None if found == image.sha256 else f"found the sha256 {found[:12]}…, expected {image.sha256[:12]}…"


def _seals(journal: bytes) -> list[tuple[int, dict[str, Any]]]:
    """The events that seal, with the place of their lines; other lines are not parsed."""
    found, key = [], f'"{SEAL}"'.encode()
    at = journal.find(key)
    while at >= 0:
        start, end = journal.rfind(b"\n", 0, at) + 1, journal.find(b"\n", at)
        end = len(journal) if end < 0 else end
        try:
            value = json.loads(journal[start:end])
        except ValueError:
            value = None  # A torn last line.
        if isinstance(value, dict) and SEAL in value and "i" not in value:
            found.append((start, value))
        at = journal.find(key, end)
    return found
