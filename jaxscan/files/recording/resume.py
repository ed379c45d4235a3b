"""Going on with a capture that was interrupted."""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.capture import (
    HEADER_NAME,
    JOURNAL_NAME,
    MAX_JOURNAL_BYTES,
    Record,
    exposure_levels,
    parse_header,
    read_journal,
)
from jaxscan.files.disk import MEGABYTE, read_bounded, write_atomically
from jaxscan.files.recording.store import Storage
from jaxscan.files.recording.writer import CaptureWriter, require_no_links


def resume_capture(
    path: str | Path, *, storage: Storage | None = None, durable: bool = True, digests: bool = False
) -> CaptureWriter:
    """Append to an existing capture.

    A torn last line, which would stand in the middle from now on, is removed, and the event
    "resume" is noted.

    Args:
        path: The folder.
        storage: As of `create_capture`; by default that of the last record, "png" before the first.
        durable: As of `create_capture`.
        digests: As of `create_capture`.

    Returns:
        The writer; its next number follows the largest in the journal.

    Raises:
        CaptureError: If it is no capture, damaged in another way, or has a link where something would be written.
    """
    path = Path(path)
    require_no_links(path)
    header_name, journal = str(path / HEADER_NAME), path / JOURNAL_NAME
    header = parse_header(read_bounded(header_name, MEGABYTE, name=header_name, error=CaptureError), name=header_name)
    data = read_bounded(journal, MAX_JOURNAL_BYTES, name=str(journal), error=CaptureError)
    names = tuple(laser.name for laser in header.laser)
    records, torn = read_journal(data, name=str(journal), kind=header.kind, laser_names=names)
    lines = [line for line in data.split(b"\n") if line.strip()]
    if torn:
        lines.pop()
    whole = b"".join(line + b"\n" for line in lines)
    if whole != data:
        write_atomically(journal, whole, durable=durable, error=CaptureError)
    values = (json.loads(line) for line in lines)
    taken = Counter(value["i"] for value in values if "i" in value)
    try:
        for folder in ("on", "off"):
            (path / folder).mkdir(exist_ok=True)
        levels = exposure_levels(records[-1].on) if records else None
        writer = CaptureWriter(
            path,
            header,
            storage=storage or _storage(records),
            durable=durable,
            digests=digests,
            taken=taken,
            levels=levels,
        )
    except OSError as problem:
        raise CaptureError(f"{path}: cannot be written: {problem.strerror or problem}.") from problem
    writer.event("resume")
    return writer


def _storage(records: Sequence[Record]) -> Storage:
    images = (*records[-1].on, *records[-1].off) if records else ()
    return "npy" if any(one.index is not None for one in images) else "png"
