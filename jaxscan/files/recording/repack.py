"""Copying a capture with its images stored in another way: packed, as PNG files, or as raw frames in shards."""

import hashlib
import itertools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import (
    HEADER_NAME,
    HEADER_SEAL,
    SEAL,
    SEALED_RECORDS,
    Capture,
    Record,
    cores,
    journal_objects,
    open_capture,
    read_texts,
)
from jaxscan.files.disk import write_atomically
from jaxscan.files.recording.store import Storage
from jaxscan.files.recording.writer import CaptureWriter, check_new_folder, create_capture, whole_capture


Progress = Callable[[int, int], None]

_SEAL_KEYS = (SEAL, HEADER_SEAL, SEALED_RECORDS, "source")


def repack_capture(
    source: str | Path, target: str | Path, *, storage: Storage, progress: Progress | None = None
) -> Capture:
    """Copy a capture, its images stored in another way.

    The header stays the same, byte for byte, and every record and event keeps all of its keys; only
    the names of the images are new. Records are in the order of their numbers; takes that were
    replaced by a later one, and a torn last line, are left out. Digests of the new images replace
    those of the old ones, which were compared when they were read. A new seal, which names the
    digest of the old journal, replaces the old ones.

    Args:
        source: The capture.
        target: Folder of the new one; it must not exist, and appears only when it is complete.
        storage: How images are stored there; see `create_capture`.
        progress: Called with (records done, records in all).

    Raises:
        CaptureError: If the source is damaged, or the target exists or cannot be written. Then
            nothing is left behind.
    """
    source, target = Path(source), Path(os.path.abspath(target))
    check_new_folder(target)
    capture = open_capture(source)
    texts = read_texts(source)
    if texts.digest() != capture.digest():
        raise CaptureError(f"{source}: has changed while it was read; end the capture first.")
    values = list(_ordered(texts.journal_bytes))
    with whole_capture(target) as part:
        with create_capture(part, capture.header, storage=storage, durable=False, digests=True) as writer:
            _copy(capture, writer, values, progress)
            # Before the seal, which binds it.
            write_atomically(part / HEADER_NAME, texts.header_bytes, durable=False, error=CaptureError)
            writer.seal(source={SEAL: hashlib.sha256(texts.journal_bytes).hexdigest()})
    return open_capture(target)


def _copy(capture: Capture, writer: CaptureWriter, values: Iterable[dict[str, Any]], progress: Progress | None) -> None:
    """All records and events; images are read a few records ahead."""
    records = {record.i: record for record in capture.records}
    ahead: deque[tuple[dict[str, Any], Future[dict[str, list[np.ndarray]]] | None]] = deque()
    done = itertools.count(1)
    pool = ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-decode")
    values = iter(values)
    try:
        while True:
            for value in itertools.islice(values, 2 * cores() + 1 - len(ahead)):
                images = pool.submit(_images, capture, records[value["i"]]) if "i" in value else None
                ahead.append((value, images))
            if not ahead:
                break
            value, images = ahead.popleft()
            if images is None:
                if SEAL in value:
                    value = {key: kept for key, kept in value.items() if key not in _SEAL_KEYS}
                if value != {"event": "seal"}:
                    writer.append_event(value)
                continue
            writer.append_line(value, images.result())
            if progress is not None:
                progress(next(done), len(records))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _images(capture: Capture, record: Record) -> dict[str, list[np.ndarray]]:
    sides = {"on": record.on, "off": record.off}
    return {side: [capture.image(one) for one in images] for side, images in sides.items()}


def _ordered(journal: bytes) -> Iterator[dict[str, Any]]:
    """Records by number, each followed by the events that followed it in the journal."""
    values = [value for _, value in journal_objects(journal)]
    winner = {value["i"]: number for number, value in enumerate(values) if "i" in value}
    after, keyed = -1, []
    for number, value in enumerate(values):
        if "i" in value:
            after = value["i"]
        if "i" not in value or winner[value["i"]] == number:
            keyed.append((after, "i" not in value, number))
    for _, _, number in sorted(keyed):
        yield values[number]
