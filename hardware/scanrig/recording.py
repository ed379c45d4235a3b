"""A session's files: the journal of a capture, the lock of its folder, and free space."""

import contextlib
import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import JOURNAL_NAME, MAX_LINE_BYTES, CaptureHeader, seal
from jaxscan.files.disk import FolderLock, append_whole, open_to_write, remove_stale
from jaxscan.files.recording import LOCK_NAME, CaptureWriter, create_capture, require_no_links, resume_capture
from scanrig.clock import Clock
from scanrig.errors import SessionError


def folder_lock(folder: Path) -> FolderLock:
    """The lock of a folder, which is not held yet; it raises `SessionError` where another session has it."""
    remedy = "wait for it, or choose another folder"
    return FolderLock(folder / LOCK_NAME, error=SessionError, busy="in use by {}", remedy=remedy)


_FULL = {errno.ENOSPC, errno.EDQUOT} if hasattr(errno, "EDQUOT") else {errno.ENOSPC}
KEPT_PAIRS = 2
"""There must be space for this many pairs before one is taken."""


class DiskFull(SessionError):
    """No space for the next pair; the capture is whole and can be resumed."""


def require_space(folder: Path, needed: int, *, purpose: str) -> None:
    """Raise DiskFull unless the disk of a folder has so much space [bytes]; `purpose` is for the message."""
    free = free_bytes(folder)
    if free < needed:
        raise DiskFull(
            f"{folder}: {readable(free)} are free, {purpose} needs {readable(needed)}; "
            "make room, then resume the capture."
        )


def free_bytes(folder: Path) -> int:
    """Space that this user may still write [bytes]."""
    return shutil.disk_usage(folder).free


def is_full(problem: BaseException) -> bool:
    """Whether an error, or one of its causes, is a full disk."""
    cause: BaseException | None = problem
    while cause is not None:
        if isinstance(cause, DiskFull) or (isinstance(cause, OSError) and cause.errno in _FULL):
            return True
        cause = cause.__cause__
    return False


def readable(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


class Ledger:
    """Appends pairs and events, from one thread at a time; events before `create` or `resume` are held back."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self.folder = folder
        self.events: list[dict[str, Any]] = []
        self._clock = clock
        self._writer: CaptureWriter | None = None
        self._waiting: list[dict[str, Any]] = []

    @property
    def begun(self) -> bool:
        """Whether there is a capture to write to."""
        return self._writer is not None

    def create(self, header: CaptureHeader) -> None:
        """Begin the capture. Raises CaptureError if the folder is not empty or cannot be written."""
        self._attach(create_capture(self.folder, header, digests=True))

    def resume(self) -> None:
        """Continue the capture; files that a crash left half written are removed. Raises CaptureError."""
        require_no_links(self.folder)
        for folder in (self.folder, self.folder / "on", self.folder / "off"):
            remove_stale(folder)
        self._attach(resume_capture(self.folder, digests=True))

    def note(self, name: str, **fields: Any) -> None:
        self.write(self.event(name, **fields))

    def event(self, name: str, **fields: Any) -> dict[str, Any]:
        """An event of this moment, for `write`."""
        now = {"time": self._clock.utc(), "time_s": round(self._clock.now(), 6)}
        event = fitting({"event": name, **now, **fields})
        self.events.append(event)
        return event

    def write(self, event: dict[str, Any]) -> None:
        """Write an event; it is on the disk when this returns, if the capture has begun. Raises CaptureError."""
        if self._writer is None:
            self._waiting.append(event)
        else:
            self._writer.append_event(event)
            self._writer.flush()

    def add(self, number: int, on: np.ndarray, off: np.ndarray, fields: dict[str, Any]) -> None:
        """Add a record, uint16 where the header has `bits`; it is on the disk when this returns.

        Raises:
            CaptureError: If it cannot be written; the capture ends with the record before it.
        """
        if self._writer is None:
            raise CaptureError(f"{self.folder}: no capture was begun; begin or resume one before adding records.")
        self._writer.append(i=number, on=on, off=off, **fields)
        self._writer.flush()

    def end(self, status: str, **fields: Any) -> str:
        """Note the end with the seal of the journal, and close; returns why that could not be written, "" if it was."""
        writer, self._writer = self._writer, None
        if writer is None:
            return ""
        with contextlib.suppress(CaptureError):  # The caller whose append failed has had the error.
            writer.close()
        try:
            event = self.event("end", status=status, **fields, **seal(self.folder))
            _append_line(self.folder / JOURNAL_NAME, json.dumps(event).encode() + b"\n")
        except (CaptureError, OSError) as problem:
            return f"the end could not be noted in the journal: {problem}"
        return ""

    def _attach(self, writer: CaptureWriter) -> None:
        self._writer = writer
        waiting, self._waiting = self._waiting, []
        for event in waiting:
            writer.append_event(event)
        writer.flush()


def fitting(event: dict[str, Any]) -> dict[str, Any]:
    """An event that fits into a line of the journal; where it is too long, its longest fields are left out."""
    lengths = {key: len(json.dumps({key: value})) for key, value in event.items()}
    for key in sorted(lengths, key=lengths.__getitem__, reverse=True):
        if sum(lengths.values()) < MAX_LINE_BYTES:
            break
        event = {**event, key: f"left out: {lengths[key]} bytes"}
        lengths[key] = len(json.dumps({key: event[key]}))
    return event


def _append_line(path: Path, line: bytes) -> None:
    """Append a whole line to a journal that exists, or nothing."""
    with open_to_write(path, "change") as journal:
        end = journal.seek(0, os.SEEK_END)
        if end and os.pread(journal.fileno(), 1, end - 1) != b"\n":
            raise OSError("its last line is torn")
        append_whole(journal, line, durable=True)


AHEAD = 4
"""Pairs that may wait to be proven and written; the table stands still while there are more."""
