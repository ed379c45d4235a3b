"""Whether the images of a capture are still those that were written, by the digests that its records carry."""

import hashlib
import os
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxscan.errors import CaptureError
from jaxscan.files.capture.decode import cores
from jaxscan.files.capture.header import CaptureHeader, frame_shape
from jaxscan.files.capture.journal import JOURNAL_NAME, Record, journal_objects
from jaxscan.files.capture.references import Folder, ImageRef
from jaxscan.files.capture.shards import Shards
from jaxscan.files.capture.texts import read_texts


SEAL = "journal_sha256"
"""Key of an event: the sha256 of the journal's bytes before the event's own line."""
_BLOCK = 64


@dataclass(frozen=True)
class Problem:
    """Something that is not as it was written."""

    record: int | None
    """Number of the record whose image it is; None: it concerns the journal."""
    message: str
    """The file, what was found, and what was expected."""
    lasting: bool = False
    """Whether it stays where the capture is gone on with; what an interruption leaves behind does not."""

    def __str__(self) -> str:
        return self.message if self.record is None else f"record {self.record}: {self.message}"


def verify_capture(path: str | Path, *, progress: Callable[[int, int], None] | None = None) -> list[Problem]:
    """Compare every image of a capture with the sha256 in its record, and the journal with its seals.

    Of records without digests it is only seen that their images exist.

    Args:
        path: The folder.
        progress: Called with (records done, records in all).

    Returns:
        What is wrong, in the order of the journal's records; empty for a sound capture.

    Raises:
        CaptureError: If header or journal cannot be read.
    """
    path = Path(path)
    texts = read_texts(path)
    records, journal = texts.records, texts.journal_bytes
    problems = [Problem(None, note) for note in texts.notes] + _broken_seals(journal, str(path / JOURNAL_NAME))
    sums = _digests(journal)
    look = _Looker(path, texts.header)
    with ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-verify") as pool:
        for start in range(0, len(records), _BLOCK):
            block = records[start : start + _BLOCK]
            for found in pool.map(lambda record: look.at(record, sums.get(record.i)), block):
                problems += found
            if progress is not None:
                progress(start + len(block), len(records))
    return problems


class _Looker:
    """Reads images as bytes; used by several threads."""

    def __init__(self, path: Path, header: CaptureHeader) -> None:
        self._folder = Folder(path)
        self._shards = Shards(path, frame_shape(header))

    def at(self, record: Record, sums: Any) -> list[Problem]:
        """What is wrong with one record's images."""
        sums = sums if isinstance(sums, dict) else {}
        problems = []
        for side, images in (("on", record.on), ("off", record.off)):
            expected = sums.get(side)
            listed = expected if isinstance(expected, list) else [expected] * min(len(images), 1)
            for number, image in enumerate(images):
                message = self._wrong(image, listed[number] if number < len(listed) else None)
                if message is not None:
                    problems.append(Problem(record.i, message))
        return problems

    def _wrong(self, image: ImageRef, expected: Any) -> str | None:
        try:
            located = self._folder.locate(image)
            if not isinstance(expected, str):
                return None
            if not re.fullmatch("[0-9a-f]{64}", expected):
                return f"{image}: found {expected!a:.40} in its record, expected a sha256."
            found = self._digest(image, located)
        except CaptureError as problem:
            return str(problem)
        except OSError as problem:
            return f"{image}: cannot be read: {problem.strerror or problem}."
        if found == expected:
            return None
        return f"{image}: found the sha256 {found[:12]}…, expected {expected[:12]}…; the file has changed."

    def _digest(self, image: ImageRef, located: Path) -> str:
        if image.index is not None:
            return hashlib.sha256(self._shards.image(image).tobytes()).hexdigest()
        with open(located, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


def _digests(journal: bytes) -> dict[int, Any]:
    """What the last complete line of each record says of its digests."""
    return {value["i"]: value.get("sha256") for _, value in journal_objects(journal) if "i" in value}


def _broken_seals(journal: bytes, name: str) -> list[Problem]:
    """Seals that do not fit what stands before them."""
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
    try:
        with open(os.path.join(path, JOURNAL_NAME), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as problem:
        raise CaptureError(f"{path / JOURNAL_NAME}: cannot be read: {problem.strerror or problem}.") from problem
