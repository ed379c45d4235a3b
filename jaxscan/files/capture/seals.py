"""Seals and digests: how a change of a capture since it was written is noticed.

A record holds the sha256 of its images. A seal, at the end of the journal, holds those of the journal before it and of
the header, and the number of records. A change of an image therefore needs a change of the journal, and of the seal.
"""

import functools
import hashlib
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import HEADER_NAME, frame_shape, image_limit
from jaxscan.files.capture.images import Shards, cores, difference, frame_digest
from jaxscan.files.capture.journal import (
    JOURNAL_NAME,
    MAX_JOURNAL_BYTES,
    CaptureTexts,
    Folder,
    ImageRef,
    Record,
    journal_objects,
    read_texts,
)
from jaxscan.files.disk import MEGABYTE, file_digest, read_bounded


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


# The check of a capture: its images against the digests in its records, header and journal against its seals.

_BLOCK = 256
_KEPT = 1 << 16
"""Images whose digests are kept: many records may name one."""


@dataclass(frozen=True)
class Problem:
    """A difference from the capture as it was written."""

    record: int | None
    """Number of the record that the image belongs to; None for the journal."""
    message: str
    lasting: bool = False
    """Whether resuming the capture leaves it; traces of an interruption are cleaned up."""

    def __str__(self) -> str:
        return self.message if self.record is None else f"record {self.record}: {self.message}"


def verify_capture(
    path: str | Path, *, texts: CaptureTexts | None = None, progress: Callable[[int, int], None] | None = None
) -> list[Problem]:
    """Compare every image of a capture with the sha256 in its record, header and journal with its seals.

    For records without digests, it is only checked that their images exist.

    Args:
        texts: Its header and journal, where they were read before.
        progress: Called with (records done, records in all).

    Returns:
        The problems, in the order of the records; empty for an intact capture.

    Raises:
        CaptureError: If header or journal cannot be read.
    """
    path = Path(path)
    texts = texts or read_texts(path)
    records = texts.records
    problems = [Problem(None, note) for note in texts.notes]
    problems += [Problem(None, broken, lasting=True) for broken in sealing(texts, path).broken]
    folder, shards = Folder(path), Shards(path, frame_shape(texts.header))
    limit = image_limit(texts.header)

    @functools.lru_cache(_KEPT)
    def digest(image: ImageRef) -> str:
        located = folder.locate(image)
        if image.index is not None:
            return frame_digest(shards.image(image))
        return file_digest(located, limit=limit, error=CaptureError).removeprefix("sha256:")

    with ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-verify") as pool:
        for start in range(0, len(records), _BLOCK):
            block = records[start : start + _BLOCK]
            for found in pool.map(lambda record: _problems(record, folder, digest), block):
                problems += found
            if progress is not None:
                progress(start + len(block), len(records))
    return problems


def seal_note(path: str | Path, *, texts: CaptureTexts | None = None) -> str:
    """Why a change of the capture could stay unnoticed, in a sentence; "" where seal and digests cover all of it.

    Raises:
        CaptureError: If header or journal cannot be read.
    """
    texts = texts or read_texts(Path(path))
    state = sealing(texts, Path(path))
    bare = [record.i for record in texts.records if any(one.sha256 is None for one in (*record.on, *record.off))]
    if len(bare) == len(texts.records):
        return f"{path}: not sealed: its records have no digests, so it is only known that all images are there."
    if bare:
        return f"{path}: {len(bare)} of {len(texts.records)} records have no digests; the first is record {bare[0]}."
    return state.note


def _problems(record: Record, folder: Folder, digest: Callable[[ImageRef], str]) -> list[Problem]:
    """The problems of one record's images; called by several threads."""
    problems = []
    for image in (*record.on, *record.off):
        try:
            # Without exposure and digest, so that an image that many records name is hashed once.
            found = digest(ImageRef(image.path, image.index)) if image.sha256 is not None else ""
            if image.sha256 is None:
                folder.locate(image)
        except CaptureError as problem:
            problems.append(Problem(record.i, str(problem)))
            continue
        if (differs := difference(image, found)) is not None:
            problems.append(Problem(record.i, f"{image}: {differs}; the file has changed."))
    return problems
