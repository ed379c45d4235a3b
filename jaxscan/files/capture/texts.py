"""The two text files of a capture, header and journal, read together."""

import hashlib
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import HEADER_NAME, MAX_HEADER_BYTES, CaptureHeader, parse_header
from jaxscan.files.capture.journal import JOURNAL_NAME, MAX_JOURNAL_BYTES, Record, read_journal
from jaxscan.files.disk import read_bounded


class CaptureTexts(NamedTuple):
    """Header and journal of a capture, as bytes and parsed."""

    header: CaptureHeader
    records: tuple[Record, ...]
    """Sorted by their number, one per number."""
    notes: tuple[str, ...]
    """A sentence if a torn last line was left out."""
    takes: dict[int, int]
    """How many lines each record has in the journal."""
    header_bytes: bytes
    journal_bytes: bytes

    def digest(self) -> str:
        """The sha256 of both files, as "sha256:<hex>"."""
        digest = hashlib.sha256(self.header_bytes)
        digest.update(self.journal_bytes)
        return "sha256:" + digest.hexdigest()


def read_texts(folder: Path) -> CaptureTexts:
    """Read header and journal.

    Raises:
        CaptureError: With the file, and the line or key, that is missing or wrong.
    """
    header_path, journal_path = folder / HEADER_NAME, folder / JOURNAL_NAME
    header_bytes = read_bounded(header_path, MAX_HEADER_BYTES, error=CaptureError, links="refuse")
    header = parse_header(header_bytes, name=str(header_path))
    journal_bytes = read_bounded(journal_path, MAX_JOURNAL_BYTES, error=CaptureError, links="refuse")
    names = tuple(laser.name for laser in header.laser)
    carries = "scanner" if header.turntable is None else header.turntable.carries
    journal = read_journal(journal_bytes, name=str(journal_path), kind=header.kind, laser_names=names, carries=carries)
    return CaptureTexts(header, *journal, header_bytes, journal_bytes)
