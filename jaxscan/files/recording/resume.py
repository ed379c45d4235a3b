"""Going on with a capture that was interrupted."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.capture import JOURNAL_NAME, Record, exposure_levels, journal_objects, read_texts
from jaxscan.files.disk import write_atomically
from jaxscan.files.recording.folder import require_no_links
from jaxscan.files.recording.store import Storage, WriteSettings
from jaxscan.files.recording.writer import CaptureWriter


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
    texts = read_texts(path)
    lines = [line for line in texts.journal_bytes.split(b"\n") if line.strip()]
    if texts.notes:
        lines.pop()
    whole = b"".join(line + b"\n" for line in lines)
    if whole != texts.journal_bytes:
        write_atomically(path / JOURNAL_NAME, whole, durable=durable, error=CaptureError)
    taken = Counter(value["i"] for _, value in journal_objects(whole) if "i" in value)
    try:
        for folder in ("on", "off"):
            (path / folder).mkdir(exist_ok=True)
        levels = exposure_levels(texts.records[-1].on) if texts.records else None
        settings = WriteSettings(storage or _storage(texts.records), durable, digests)
        writer = CaptureWriter(path, texts.header, settings=settings, taken=taken, levels=levels)
    except OSError as problem:
        raise CaptureError(f"{path}: cannot be written: {problem.strerror or problem}.") from problem
    writer.event("resume")
    return writer


def _storage(records: Sequence[Record]) -> Storage:
    images = (*records[-1].on, *records[-1].off) if records else ()
    return "npy" if any(one.index is not None for one in images) else "png"
