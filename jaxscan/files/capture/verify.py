"""Check of a capture: its images against the digests in its records, its journal against its seals."""

import hashlib
import itertools
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxscan.errors import CaptureError
from jaxscan.files.capture.decode import cores
from jaxscan.files.capture.header import frame_shape
from jaxscan.files.capture.journal import JOURNAL_NAME, Record, journal_objects
from jaxscan.files.capture.references import Folder, ImageRef
from jaxscan.files.capture.shards import Shards
from jaxscan.files.capture.texts import read_texts
from jaxscan.files.disk import file_digest


SEAL = "journal_sha256"
"""Key of an event: the sha256 of the journal's bytes before the line of the event."""
_BLOCK = 64


@dataclass(frozen=True)
class Problem:
    """A difference from the capture as it was written."""

    record: int | None
    """Number of the record that the image belongs to; None for the journal."""
    message: str
    """The file, and the contents found and expected."""
    lasting: bool = False
    """Whether it stays when the capture is resumed; traces of an interruption do not."""

    def __str__(self) -> str:
        return self.message if self.record is None else f"record {self.record}: {self.message}"


def verify_capture(path: str | Path, *, progress: Callable[[int, int], None] | None = None) -> list[Problem]:
    """Compare every image of a capture with the sha256 in its record, and the journal with its seals.

    For records without digests, it is only checked that their images exist.

    Args:
        path: The folder.
        progress: Called with (records done, records in all).

    Returns:
        The problems, in the order of the records; empty for an intact capture.

    Raises:
        CaptureError: If header or journal cannot be read.
    """
    path = Path(path)
    texts = read_texts(path)
    records, journal = texts.records, texts.journal_bytes
    problems = [Problem(None, note) for note in texts.notes] + _broken_seals(journal, str(path / JOURNAL_NAME))
    sums = _digests(journal)
    folder, shards = Folder(path), Shards(path, frame_shape(texts.header))
    with ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-verify") as pool:
        for start in range(0, len(records), _BLOCK):
            block = records[start : start + _BLOCK]
            for found in pool.map(lambda record: _problems(record, sums.get(record.i), folder, shards), block):
                problems += found
            if progress is not None:
                progress(start + len(block), len(records))
    return problems


def _problems(record: Record, sums: Any, folder: Folder, shards: Shards) -> list[Problem]:
    """The problems of one record's images; called by several threads."""
    sums = sums if isinstance(sums, dict) else {}
    problems = []
    for side, images in (("on", record.on), ("off", record.off)):
        expected = sums.get(side)
        listed = expected if isinstance(expected, list) else [expected] * min(len(images), 1)
        for image, digest in itertools.zip_longest(images, listed[: len(images)]):
            try:
                message = _difference(image, digest, folder.locate(image), shards)
            except CaptureError as problem:
                message = str(problem)
            if message is not None:
                problems.append(Problem(record.i, message))
    return problems


def _difference(image: ImageRef, expected: Any, located: Path, shards: Shards) -> str | None:
    """How an image differs from its digest; None if it does not, or has no digest."""
    if not isinstance(expected, str):
        return None
    if not re.fullmatch("[0-9a-f]{64}", expected):
        return f"{image}: found {expected!a:.40} in its record, expected a sha256."
    if image.index is not None:
        found = hashlib.sha256(shards.image(image).tobytes()).hexdigest()
    else:
        found = file_digest(located, error=CaptureError).removeprefix("sha256:")
    if found == expected:
        return None
    return f"{image}: found the sha256 {found[:12]}…, expected {expected[:12]}…; the file has changed."


def _digests(journal: bytes) -> dict[int, Any]:
    """The digests in the last complete line of each record."""
    return {value["i"]: value.get("sha256") for _, value in journal_objects(journal) if "i" in value}


def _broken_seals(journal: bytes, name: str) -> list[Problem]:
    """Seals that do not fit the lines before them."""
    sealed, at = hashlib.sha256(), 0
    problems = []
    for start, value in journal_objects(journal):
        if "i" in value or SEAL not in value:
            continue
        sealed.update(journal[at:start])
        at = start
        if sealed.hexdigest() != value[SEAL]:
            line = journal.count(b"\n", 0, start) + 1
            message = f"{name}: line {line}: the seal does not fit the lines before it."
            problems.append(Problem(None, message, lasting=True))
    return problems


def seal(path: Path) -> str:
    """The sha256 of a capture's journal as it is now.

    Raises:
        CaptureError: If it cannot be read.
    """
    return file_digest(path / JOURNAL_NAME, error=CaptureError).removeprefix("sha256:")
