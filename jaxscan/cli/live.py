"""The live cloud: stripes are found in a thread while the rig scans; the rig never waits for them."""

import queue
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscan import api
from jaxscan.errors import CaptureError, JaxscanError
from jaxscan.files.capture import Capture, CaptureHeader, open_capture
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import (
    DEFAULTS,
    IncomingStripes,
    PlannedSweep,
    Progress,
    ReconstructSettings,
    RecordedPair,
    Show,
)
from jaxscan.stripes import level_exposures


_PATIENCE_S = 5.0
"""A chunk that is not full is computed after this time."""
_TICK_S = 0.1
"""Longest wait for a pair."""
_END_S = 600.0
"""Longest wait at the end for the pairs in the queue."""


class LiveStatus(NamedTuple):
    """State of the live cloud."""

    records: int
    """Records whose stripes are found."""
    points: int
    later: int
    """Records that will be read from the disk when there is time."""
    problem: str
    """Why the computation stopped; empty while it runs."""


class LiveResult(NamedTuple):
    """The cloud of the finished capture."""

    cloud: api.PointCloud
    live: bool
    """Whether its stripes were found during the scan."""
    notes: tuple[str, ...]
    noise: str
    """A line on the noise of a frame."""


class LiveCloud:
    """Finds stripes in a thread while pairs come in. The context manager ends the thread.

    `add` never waits. If the computer is too slow, a pair stays on the disk and is read when there is time, or at
    the end.
    """

    def __init__(
        self,
        folder: Path,
        header: CaptureHeader,
        scanner: Scanner,
        *,
        steps: int,
        settings: ReconstructSettings = DEFAULTS,
        show: Show | None = None,
    ) -> None:
        """Check that the sweep fits the scanner, and start the thread.

        Args:
            folder: The folder of the capture; it may be created later.
            header: The header of the capture.
            scanner: The calibrated rig.
            steps: Number of records of the whole sweep.
            settings: As for `reconstruct`.
            show: Gets the points of some records as soon as they are computed, in the thread.

        Raises:
            CalibrationError: If the sweep does not fit the scanner.
        """
        camera, size = header.camera, (header.camera.width, header.camera.height)
        carries = None if header.turntable is None else header.turntable.carries
        bits = camera.bits or 8
        sweep = PlannedSweep(
            camera.pixel_format,
            camera.response,
            header.lasers,
            size,
            carries,
            steps,
            exposures=level_exposures(bits),
            compression=camera.compression,
            bits=bits,
        )
        # The frames that come are in 8 bits; on the disk are the levels of more.
        self._reads_all = bits > 8
        self._stripes = IncomingStripes(sweep, scanner, settings, show)
        self._folder, self._scanner, self._settings, self._steps = folder, scanner, settings, steps
        self._first: dict[int, RecordedPair] = {}
        self._given: set[int] = set()
        self._learned_again = False
        self._queue: queue.Queue[RecordedPair] = queue.Queue(self._stripes.size)
        self._lock = threading.Lock()
        self._later: set[int] = set()
        self._unread: set[int] = set()
        self._capture: tuple[int, Capture] | None = None
        self._changes = 0
        self._problem: Exception | None = None
        self._ending, self._stopped = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._work, name="jaxscan-live", daemon=True)
        self._thread.start()

    def add(self, number: int, angle: float, on: np.ndarray, off: np.ndarray) -> None:
        """Take a pair that is on the disk. Returns at once.

        Args:
            number: Number of the record; a number that came before is a retake.
            angle: The table's angle [rad from home].
            on: Laser-on frame, uint8 [rows, columns(, 3)]; that of a camera of more than 8 bits is read from the disk.
            off: Laser-off frame.
        """
        if self._problem is not None or not 0 <= number < self._steps:
            return
        # Copies: the camera may use the memory of its frames again.
        pair = RecordedPair(number, angle, np.array(on), np.array(off))
        with self._lock:
            self._notice(number)
            self._later.discard(number)
            if self._reads_all:
                self._later.add(number)
                self._changes += 1
                return
            try:
                self._queue.put_nowait(pair)
            except queue.Full:
                self._later.add(number)
                self._changes += 1

    def add_from_disk(self) -> int:
        """Take the records that are in the capture already. The thread reads them during the scan.

        Returns:
            Their number.

        Raises:
            CaptureError: If the capture cannot be read.
        """
        capture = open_capture(self._folder)
        numbers = {record.i for record in capture.records if record.i < self._steps}
        with self._lock:
            self._capture = (self._changes, capture)
            for number in numbers:
                self._notice(number)
            self._later |= numbers
        return len(numbers)

    def status(self) -> LiveStatus:
        """The state of the live cloud."""
        points = self._stripes.points.copy()
        with self._lock:
            later = len(self._later | self._unread)
        problem = "" if self._problem is None else " ".join(str(self._problem).split())
        return LiveStatus(int((points >= 0).sum()), int(points[points > 0].sum()), later, problem)

    def finish(self, progress: Progress = None) -> LiveResult:
        """The cloud of the capture as it is on the disk now.

        If the first records have changed since the search learned from them, or the computation stopped, the capture is
        reconstructed from the disk as `jaxscan reconstruct` does.

        Args:
            progress: Called with (records done, records in all) while records are read from the disk.

        Raises:
            CaptureError, CalibrationError: As for `reconstruct`.
        """
        self._ending.set()
        self._thread.join(_END_S)
        if self._thread.is_alive():
            raise CaptureError(f"{self._folder}: the thread of the live cloud does not end; run jaxscan reconstruct.")
        capture = open_capture(self._folder)
        numbers = [record.i for record in capture.records]
        found = self._usable(capture, numbers)
        if isinstance(found, str):
            done = api.reconstruct_capture(capture, self._scanner, settings=self._settings, progress=progress)
            return LiveResult(done.cloud, False, (found, *done.notes), done.noise)
        self._catch_up(capture, progress)
        stripes = found.finish(numbers)
        cloud = api.reconstruct(capture, self._scanner, stripes=stripes, settings=self._settings)
        return LiveResult(cloud, True, found.notes, found.noise)

    def close(self) -> None:
        """End the thread. Pairs in the queue are dropped."""
        self._stopped.set()
        self._thread.join(_END_S)

    def __enter__(self) -> "LiveCloud":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _notice(self, number: int) -> None:
        """Note whether one of the first records, from which the search learns, comes a second time."""
        if number < self._stripes.needed:
            self._learned_again |= number in self._given
            self._given.add(number)

    def _usable(self, capture: Capture, numbers: list[int]) -> IncomingStripes | str:
        """The stripes found so far, or a sentence why they do not belong to the finished capture."""
        if isinstance(self._problem, JaxscanError):
            return f"the live cloud stopped ({' '.join(str(self._problem).split())}); reconstructed from the disk"
        if self._problem is not None:
            raise self._problem
        if self._learned_again or not self._stripes.are_of(capture, numbers):
            return "the first records have changed since the scan began; reconstructed from the disk"
        return self._stripes

    def _catch_up(self, capture: Capture, progress: Progress) -> None:
        """Compute the records that were left on the disk."""
        stale, points = self._later | self._unread, self._stripes.points
        missing = [n for n, record in enumerate(capture.records) if points[record.i] < 0 or record.i in stale]
        for start in range(0, len(missing), self._stripes.size):
            some = missing[start : start + self._stripes.size]
            self._stripes.compute([_from_disk(capture, n) for n in some])
            if progress is not None:
                progress(start + len(some), len(missing))

    def _work(self) -> None:
        try:
            self._collect()
        except Exception as problem:
            # `status` and `finish` report it. The scan continues, and its pairs are on the disk.
            self._problem = problem

    def _collect(self) -> None:
        stripes = self._stripes
        chunk: dict[int, RecordedPair] = {}
        since = time.monotonic()
        while not self._stopped.is_set():
            pair = self._next()
            if pair is not None:
                since = since if chunk else time.monotonic()
                chunk[pair.number] = pair
                if self._learn(pair):
                    chunk |= self._first
                    self._first = {}
            ending = pair is None and self._ending.is_set()
            full = len(chunk) >= stripes.size
            if chunk and stripes.learned and (full or ending or time.monotonic() - since > _PATIENCE_S):
                stripes.compute(list(chunk.values()))
                chunk = {}
            elif full and not stripes.learned:
                # The search cannot learn before the first records are there; pairs in memory would pile up.
                with self._lock:
                    self._later |= chunk.keys() - self._first.keys()
                    self._changes += 1
                chunk = {}
            if ending:
                return

    def _next(self) -> RecordedPair | None:
        """The next pair of the queue, or else one from the disk."""
        try:
            return self._queue.get_nowait()
        except queue.Empty:
            number = None if self._ending.is_set() else self._take_later()
        if number is None:
            try:
                return self._queue.get(timeout=_TICK_S)
            except queue.Empty:
                return None
        try:
            return self._read(number)
        except CaptureError:
            # Its images may be replaced just now. `finish` reads it again.
            with self._lock:
                self._unread.add(number)
            return None

    def _take_later(self) -> int | None:
        with self._lock:
            wanted = [n for n in self._later if self._stripes.learned or n < self._stripes.needed]
            number = min(wanted, default=None)
            if number is not None:
                self._later.discard(number)
            return number

    def _read(self, number: int) -> RecordedPair:
        with self._lock:
            changes, known = self._changes, self._capture
        if known is None or known[0] != changes:
            known = self._capture = (changes, open_capture(self._folder))
        capture = known[1]
        for index, record in enumerate(capture.records):
            if record.i == number:
                return _from_disk(capture, index)
        raise CaptureError(f"{self._folder}: record {number} is not in the journal.")

    def _learn(self, pair: RecordedPair) -> bool:
        """Learn once the first records are complete; returns whether that was now."""
        needed = self._stripes.needed
        if self._stripes.learned or pair.number >= needed:
            return False
        self._first[pair.number] = pair
        if len(self._first) < needed:
            return False
        self._stripes.learn([self._first[n] for n in range(needed)])
        return True


def _from_disk(capture: Capture, index: int) -> RecordedPair:
    on, off = capture.frames(index)
    record = capture.records[index]
    if on is None or off is None or record.angle is None:
        raise CaptureError(f"{capture.path}: record {record.i}: expected a pair at a known angle.")
    return RecordedPair(record.i, record.angle, on, off)
