"""Writes a session's capture: a pair counts when its images and then its journal line are on the disk."""

import contextlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import JOURNAL_NAME, MAX_LINE_BYTES, CaptureHeader, seal
from jaxscan.files.disk import append_whole, open_to_write, remove_left
from jaxscan.files.recording import CaptureWriter, create_capture, require_no_links, resume_capture
from scanrig.clock import Clock


class Ledger:
    """Appends pairs and events, from one thread at a time; events before `create` or `resume` are held back."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self.folder = folder
        self.events: list[dict[str, Any]] = []
        """All events noted, in order."""
        self._clock = clock
        self._writer: CaptureWriter | None = None
        self._waiting: list[dict[str, Any]] = []

    @property
    def begun(self) -> bool:
        """Whether there is a capture to write to."""
        return self._writer is not None

    def create(self, header: CaptureHeader) -> None:
        """Begin the capture.

        Raises:
            CaptureError: If the folder is not empty or cannot be written.
        """
        self._attach(create_capture(self.folder, header, digests=True))

    def resume(self) -> None:
        """Continue the capture; files that a crash left half written are removed.

        Raises:
            CaptureError: If it cannot be read or written, or a link leads out of it.
        """
        require_no_links(self.folder)
        for folder in (self.folder, self.folder / "on", self.folder / "off"):
            remove_left(folder)
        self._attach(resume_capture(self.folder, digests=True))

    def note(self, name: str, **fields: Any) -> None:
        """Note an event; it is on the disk when this returns, if the capture has begun.

        Raises:
            CaptureError: If it cannot be written.
        """
        self.write(self.event(name, **fields))

    def event(self, name: str, **fields: Any) -> dict[str, Any]:
        """An event of this moment, for `write`."""
        event = self._event(name, fields)
        self.events.append(event)
        return event

    def write(self, event: dict[str, Any]) -> None:
        """Write an event; it is on the disk when this returns, if the capture has begun.

        Raises:
            CaptureError: If it cannot be written.
        """
        if self._writer is None:
            self._waiting.append(event)
        else:
            self._writer.append_event(event)
            self._writer.flush()

    def add(self, number: int, on: np.ndarray, off: np.ndarray, fields: dict[str, Any]) -> None:
        """Add a record; it is on the disk when this returns.

        Args:
            number: Number of the record.
            on: Laser-on image, uint8.
            off: Laser-off image, uint8.
            fields: The other fields of the record.

        Raises:
            CaptureError: If it cannot be written; the capture ends with the record before it.
        """
        if self._writer is None:
            raise CaptureError(f"{self.folder}: no capture was begun; begin or resume one before adding records.")
        self._writer.append(i=number, on=on, off=off, **fields)
        self._writer.flush()

    def end(self, status: str, **fields: Any) -> str:
        """Note the end with the seal of the journal, and close; never raises if that cannot be written.

        Returns:
            The reason why the end could not be noted; "" if it was.
        """
        writer, self._writer = self._writer, None
        if writer is None:
            return ""
        with contextlib.suppress(CaptureError):  # The caller whose append failed has had the error.
            writer.close()
        try:
            event = self._event("end", {"status": status, **fields, **seal(self.folder)})
            self.events.append(event)
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

    def _event(self, name: str, fields: dict[str, Any]) -> dict[str, Any]:
        return fitting({"event": name, "time": self._clock.utc(), "time_s": round(self._clock.now(), 6), **fields})


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
