"""Check of a capture: its images against the digests in its records, header and journal against its seals."""

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import frame_shape, image_limit
from jaxscan.files.capture.images import cores
from jaxscan.files.capture.journal import CaptureTexts, Folder, ImageRef, Record, read_texts
from jaxscan.files.capture.seals import difference, frame_digest, sealing
from jaxscan.files.capture.shards import Shards
from jaxscan.files.disk import file_digest


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
