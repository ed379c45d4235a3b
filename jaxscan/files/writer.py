"""Writing a capture: images first, whole; then the line of the journal that says they are there."""

import json
import math
import os
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.atomic import write_atomically
from jaxscan.files.header import HEADER_NAME, CaptureHeader, frame_shape, header_toml
from jaxscan.files.journal import JOURNAL_NAME, MAX_LINE_BYTES


@dataclass(frozen=True)
class _Pending:
    line: bytes
    images: list[Future[None]]


class CaptureWriter:
    """Appends records to a capture; a context manager.

    Images are encoded and written in threads, a few records behind `append`; a record's line
    enters the journal, in order, only when its images have their names. What a crash leaves
    behind is therefore a readable capture of the records before it.
    """

    def __init__(
        self, path: Path, header: CaptureHeader, *, durable: bool = True, taken: Mapping[int, int] | None = None
    ) -> None:
        """Use `create_capture` or `resume_capture`; `taken` counts the takes of each record so far."""
        self.path = path
        self.header = header
        self._durable = durable
        self._taken = dict(taken or {})
        self._next = max(self._taken, default=-1) + 1
        self._pending: deque[_Pending] = deque()
        self._failed: CaptureError | None = None
        self._journal = open(path / JOURNAL_NAME, "ab")
        self._pool = ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="jaxscan-encode")
        self._ahead = 2 * (os.cpu_count() or 1)

    def append(
        self,
        *,
        angle_deg: float | int | None,
        on: Any | None = None,
        off: Any | None = None,
        placement: int | None = None,
        i: int | None = None,
        **extra: Any,
    ) -> int:
        """Add one record.

        Args:
            angle_deg: The table's angle from home, as reached, unwrapped [deg]; None if unknown,
                which only a calibration may hold.
            on: Laser-on image, uint8 [rows, columns(, 3)], copied; None without one.
            off: Laser-off image of the same shape; None without one.
            placement: Which pose of the board it saw.
            i: The record's number; the next free one if not given. A number used before is a
                retake, and replaces that record.
            extra: Further keys, as JSON holds them: `lasers`, `time`, `microsteps`, ...

        Returns:
            The record's number.

        Raises:
            CaptureError: If the record does not fit the header, or this or an earlier record
                cannot be written. After a failed write nothing can be appended any more.
        """
        self._check_alive()
        number = self._next if i is None else i
        if number < 0:
            raise CaptureError(f"{self.path}: i = {number} is negative.")
        if self.header.kind == "sweep" and (angle_deg is None or on is None):
            raise CaptureError(f"{self.path}: record {number}: a sweep needs an angle and a laser-on image.")
        if on is None and off is None:
            raise CaptureError(f"{self.path}: record {number}: has no image.")
        if angle_deg is not None and not math.isfinite(angle_deg):
            raise CaptureError(f"{self.path}: record {number}: angle_deg = {angle_deg} is not finite.")
        images = {"on": self._copied(on, "on", number), "off": self._copied(off, "off", number)}
        retakes = self._taken.get(number, 0)
        # A retake never touches what the journal already speaks of.
        stem = f"{number:06d}" if retakes == 0 else f"{number:06d}-{retakes}"
        names = {key: None if image is None else f"{key}/{stem}.png" for key, image in images.items()}
        fields = {"i": number, "angle_deg": None if angle_deg is None else float(angle_deg), **names, **extra}
        if placement is not None:
            fields["placement"] = int(placement)
        line = self._line(fields)
        jobs = [
            self._pool.submit(self._write_image, name, image)
            for name, image in zip(names.values(), images.values(), strict=True)
            if name is not None and image is not None
        ]
        self._taken[number] = retakes + 1
        self._next = max(self._next, number + 1)
        self._pending.append(_Pending(line, jobs))
        self._advance()
        return number

    def event(self, name: str, **extra: Any) -> None:
        """Add an event ("resume", "fault", ...), which readers skip, after all records so far."""
        self._check_alive()
        self._pending.append(_Pending(self._line({"event": name, **extra}), []))
        self._advance()

    def flush(self) -> None:
        """Wait until all records so far are in the journal.

        Raises:
            CaptureError: If one cannot be written.
        """
        self._check_alive()
        while self._pending:
            self._complete_oldest()

    def close(self) -> None:
        """Write what is pending, and end.

        Raises:
            CaptureError: If a record cannot be written; those before it are in the journal.
        """
        if self._journal.closed:
            return
        try:
            if self._failed is None:
                self.flush()
        finally:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._journal.close()

    def __enter__(self) -> "CaptureWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _check_alive(self) -> None:
        if self._failed is not None:
            raise self._failed
        if self._journal.closed:
            raise CaptureError(f"{self.path}: the capture is closed; nothing can be appended.")

    def _copied(self, image: Any | None, key: str, number: int) -> np.ndarray | None:
        """A copy: the caller may reuse its buffer while threads still encode."""
        if image is None:
            return None
        copied = np.array(image)
        expected = frame_shape(self.header)
        if copied.dtype != np.uint8 or copied.shape != expected:
            raise CaptureError(
                f"{self.path}: record {number}: {key}: found {copied.dtype} with shape {copied.shape}, "
                f"expected uint8 with shape {expected}."
            )
        return copied

    def _line(self, fields: dict[str, Any]) -> bytes:
        try:
            line = json.dumps(fields, allow_nan=False).encode() + b"\n"
        except (TypeError, ValueError) as problem:
            raise CaptureError(f"{self.path}: {problem}: a record holds only what JSON can.") from problem
        if len(line) > MAX_LINE_BYTES:
            raise CaptureError(f"{self.path}: a record of {len(line)} bytes, more than {MAX_LINE_BYTES}.")
        return line

    def _write_image(self, name: str, image: np.ndarray) -> None:
        # Here, so that reading a capture's header does not load OpenCV.
        from jaxscan.vision.images import encode_png

        write_atomically(self.path / name, encode_png(image), durable=self._durable, error=CaptureError)

    def _advance(self) -> None:
        """Complete what is finished, and wait where too much is not."""
        while len(self._pending) > self._ahead or (self._pending and _finished(self._pending[0])):
            self._complete_oldest()

    def _complete_oldest(self) -> None:
        pending = self._pending.popleft()
        try:
            for image in pending.images:
                image.result()
            self._journal.write(pending.line)
            self._journal.flush()
            if self._durable:
                os.fsync(self._journal.fileno())
        except OSError as problem:
            self._failed = CaptureError(
                f"{self.path / JOURNAL_NAME}: cannot be written: {problem.strerror or problem}."
            )
            raise self._failed from problem
        except CaptureError as problem:
            self._failed = problem
            raise


def _finished(pending: _Pending) -> bool:
    return all(image.done() for image in pending.images)


def create_capture(path: str | Path, header: CaptureHeader, *, durable: bool = True) -> CaptureWriter:
    """Begin a new capture.

    Args:
        path: The folder; made if it does not exist.
        header: What becomes `capture.toml`.
        durable: Wait for the disk with every record, so that a loss of power costs only the last.
            A simulation, which can be run again, saves the time.

    Returns:
        The writer; use it in a `with` statement.

    Raises:
        CaptureError: If the folder exists and is not empty, or cannot be written.
    """
    path = Path(path)
    toml = header_toml(header)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise CaptureError(
                f"{path}: exists and is not empty; choose another folder, a capture is never overwritten."
            )
        (path / "on").mkdir()
        (path / "off").mkdir()
        (path / JOURNAL_NAME).touch()
        # Last: a folder with a header is a capture.
        write_atomically(path / HEADER_NAME, toml, durable=durable, error=CaptureError)
        return CaptureWriter(path, header, durable=durable)
    except OSError as problem:
        raise CaptureError(f"{path}: cannot be created: {problem.strerror or problem}.") from problem
