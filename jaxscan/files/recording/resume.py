"""Resuming an interrupted capture."""

from collections.abc import Sequence
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.capture import JOURNAL_NAME, ImageRef, exposure_levels, read_texts
from jaxscan.files.disk import make_folder, reported, write_atomically
from jaxscan.files.recording.folder import require_no_links
from jaxscan.files.recording.store import Storage, WriteSettings
from jaxscan.files.recording.writer import CaptureWriter


def resume_capture(
    path: str | Path, *, storage: Storage | None = None, durable: bool = True, digests: bool = False
) -> CaptureWriter:
    """Append to an existing capture.

    A torn last line is removed, since lines will follow it, and the event "resume" is written.

    Args:
        path: The folder.
        storage: See `create_capture`; by default as in the last record, "zstd" without records.
        durable: See `create_capture`.
        digests: See `create_capture`.

    Returns:
        The writer; its next number follows the largest in the journal.

    Raises:
        CaptureError: If it is no capture, is damaged in another way, or has a link in place of a folder or the journal.
    """
    path = Path(path)
    require_no_links(path)
    texts = read_texts(path)
    lines = [line + b"\n" for line in texts.journal_bytes.split(b"\n") if line.strip()]
    journal = b"".join(lines[:-1] if texts.notes else lines)
    if journal != texts.journal_bytes:
        write_atomically(path / JOURNAL_NAME, journal, durable=durable, error=CaptureError, links="replace")
    with reported(f"{path}: cannot be written", error=CaptureError):
        for folder in ("on", "off"):
            make_folder(path / folder, own=path)
        levels = exposure_levels(texts.records[-1].on) if texts.records else None
        images = (*texts.records[-1].on, *texts.records[-1].off) if texts.records else ()
        settings = WriteSettings(storage or _stored(images), durable, digests)
        writer = CaptureWriter(path, texts.header, settings=settings, taken=texts.takes, levels=levels)
    writer.event("resume")
    return writer


def _stored(images: Sequence[ImageRef]) -> Storage:
    """The storage of a record's images."""
    if any(one.index is not None for one in images):
        return "npy"
    return "zstd" if all(one.path.endswith(".zst") for one in images) else "png"
