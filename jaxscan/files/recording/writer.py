"""A capture that is written: created, filled record by record, sealed or resumed."""

import contextlib
import math
import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import (
    HEADER_NAME,
    JOURNAL_NAME,
    MAX_IMAGES,
    CaptureHeader,
    ImageRef,
    exposure_levels,
    frame_shape,
    header_toml,
    journal_line,
    read_texts,
    seal,
)
from jaxscan.files.disk import (
    append_whole,
    check_name,
    make_folder,
    open_to_append,
    reported,
    whole_folder,
    write_atomically,
)
from jaxscan.files.recording.store import Storage, WriteSettings, image_store
from jaxscan.geometry import MOTIONS
from jaxscan.stripes import split_levels


LOCK_NAME = ".scan.lock"
"""Lock file in a folder during a capture."""


def require_no_links(path: Path) -> None:
    """Check that nothing can be written outside the folder of a capture.

    Raises:
        CaptureError: If a folder of images, the journal or the header is a link.
    """
    for name in ("on", "off", JOURNAL_NAME, HEADER_NAME):
        if os.path.islink(path / name):
            raise CaptureError(
                f"{path / name}: found a link, which may lead anywhere, expected the capture's own; "
                "nothing is written there."
            )


def is_unused(path: Path) -> bool:
    """Whether a folder is empty, or holds only a capture that was begun and has no header yet."""
    for entry in path.iterdir():
        if entry.name.startswith(".part-") or entry.name == LOCK_NAME:
            continue
        if entry.name not in ("on", "off", JOURNAL_NAME):
            return False
        if any(entry.iterdir()) if entry.is_dir() else entry.stat().st_size > 0:
            return False
    return True


class GivenFrame(NamedTuple):
    """A frame, checked and copied."""

    images: list[np.ndarray]
    """Copies, since the caller may reuse its buffers while threads still encode."""
    entry: Any
    """Its entry in the record, without the names of the files; None without a frame."""
    levels: list[float]
    """The different exposures [s], ascending; empty for a single image."""


def given_frame(given: Any | None, shape: tuple[int, ...], where: str, bits: int | None = None) -> GivenFrame:
    """A frame of a record; None without one. With `bits`, one of uint16 is kept as its levels."""
    if given is None:
        return GivenFrame([], None, [])
    if bits is not None:
        if not isinstance(given, np.ndarray) or given.dtype != np.uint16:
            raise CaptureError(f"{where}: expected one frame, uint16, for the header has bits = {bits}.")
        given = split_levels(given, bits)
    entry: Any = ""
    levels: list[float] = []
    if isinstance(given, list | tuple):
        if not 1 <= len(given) <= MAX_IMAGES:
            raise CaptureError(f"{where}: found a list of {len(given)} images, expected 1 to {MAX_IMAGES}.")
        entry = [{"file": "", "exposure_s": float(exposure)} for _, exposure in given]
        levels = sorted({one["exposure_s"] for one in entry})
        if not all(math.isfinite(exposure) and 0 < exposure <= 1e6 for exposure in levels):
            raise CaptureError(f"{where}: found the exposures {levels}, expected seconds above 0.")
        images = [np.array(image) for image, _ in given]
    else:
        images = [np.array(given)]
    for image in images:
        if image.dtype != np.uint8 or image.shape != shape:
            raise CaptureError(
                f"{where}: found {image.dtype} with shape {image.shape}, expected uint8 with shape {shape}."
            )
    return GivenFrame(images, entry, levels)


def named(entry: Any, names: Sequence[str]) -> Any:
    """The entry of a frame with the names of its files; other keys of a list stay."""
    if isinstance(entry, list):
        return [{**one, "file": name} for one, name in zip(entry, names, strict=True)]
    return names[0]


@contextlib.contextmanager
def whole_capture(target: Path) -> Iterator[Path]:
    """A folder in work, which becomes `target` at the end, and of which nothing is left after an error.

    Yields:
        Its path.

    Raises:
        CaptureError: If the target exists or cannot be written.
    """
    target = Path(os.path.abspath(target))
    check_new_folder(target)
    # Waits for the disk at the end, so that the source may be deleted afterwards.
    with reported(f"{target}: cannot be created", error=CaptureError), whole_folder(target) as part:
        yield part
        # Check again: a folder may have appeared in the meantime.
        check_new_folder(target)


def check_new_folder(target: str | Path) -> None:
    """Check that a folder can be made under this name.

    Raises:
        CaptureError: If something exists there, or its own folder does not.
    """
    target = Path(os.path.abspath(target))
    check_name(target, error=CaptureError)
    if os.path.lexists(target):
        raise CaptureError(f"{target}: exists; choose another folder, a capture is never overwritten.")
    if not os.path.isdir(target.parent):
        raise CaptureError(f"{target}: cannot be created, the folder {target.parent} does not exist; create it first.")


_NO_DIGEST = "0" * 64


@dataclass(frozen=True)
class _Pending:
    fields: dict[str, Any]
    images: dict[str, list[Future[str]]]

    def done(self) -> bool:
        """Whether all its images are written."""
        return all(image.done() for images in self.images.values() for image in images)


class CaptureWriter:
    """Appends records to a capture; a context manager.

    Images are encoded and written in threads, a few records behind `append`; a record's line
    enters the journal, in order, only when its images are in their files. After a crash the folder
    is therefore a readable capture of the records before it.
    """

    def __init__(
        self,
        path: Path,
        header: CaptureHeader,
        *,
        settings: WriteSettings,
        taken: Mapping[int, int] | None = None,
        levels: Sequence[float] | None = None,
    ) -> None:
        """Use `create_capture` or `resume_capture`.

        `taken` counts the takes of each record so far; `levels` are the exposures of a sweep's
        frames [s], empty where its records name none, None before the first record.
        """
        self.path = path
        self.header = header
        self._durable, self._digests = settings.durable, settings.digests
        self._taken = dict(taken or {})
        self._next = max(self._taken, default=-1) + 1
        self._levels = None if levels is None else list(levels)
        self._pending: deque[_Pending] = deque()
        self._failed: CaptureError | None = None
        self._store = image_store(path, frame_shape(header), settings)
        self._journal = open_to_append(path / JOURNAL_NAME)
        self._pool = ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="jaxscan-encode")
        self._ahead = 2 * (os.cpu_count() or 1)

    def append(
        self,
        *,
        angle_deg: float | int | None = None,
        on: Any | None = None,
        off: Any | None = None,
        placement: int | None = None,
        i: int | None = None,
        **extra: Any,
    ) -> int:
        """Add one record.

        Args:
            angle_deg: The table's angle from home, as reached, unwrapped [deg]; None if unknown,
                which only a calibration may hold, or without a table.
            on: Laser-on image, uint8 [rows, columns(, 3)], copied; None without one. Or a list of
                (image, exposure [s]): repetitions of an exposure are averaged by readers,
                different exposures are a bracket. Where the header has `bits`, uint16.
            off: Laser-off image or images, likewise; with the exposures of `on`.
            placement: Number of the board's pose.
            i: The record's number; the next free one if not given. A number used before is a
                retake, and replaces that record.
            extra: Further keys, as JSON holds them: `position_m` of a linear stage, `lasers`, `time`, ...

        Raises:
            CaptureError: If the record does not fit the header, or this or an earlier record
                cannot be written. After a failed write nothing can be appended any more.
        """
        self._check_alive()
        number = self._next if i is None else i
        where = f"{self.path}: record {number}"
        if number < 0:
            raise CaptureError(f"{where}: i = {number} is negative.")
        carries = "scanner" if self.header.turntable is None else self.header.turntable.carries
        key = MOTIONS[carries].key
        known = carries == "nothing" or {"angle_deg": angle_deg, **extra}.get(key) is not None
        if self.header.kind == "sweep" and (not known or on is None):
            raise CaptureError(f"{where}: a sweep needs {key} and a laser-on image.")
        if on is None and off is None:
            raise CaptureError(f"{where}: has no image.")
        if angle_deg is not None and not math.isfinite(angle_deg):
            raise CaptureError(f"{where}: angle_deg = {angle_deg} is not finite.")
        shape = frame_shape(self.header)
        bits, sides = self.header.camera.bits, (("on", on), ("off", off))
        frames = {side: given_frame(given, shape, f"{where}: {side}", bits) for side, given in sides}
        levels = [frame.levels for frame in frames.values() if frame.images]
        expected = levels[0] if self._levels is None else self._levels
        if self.header.kind == "sweep" and any(one != expected for one in levels):
            raise CaptureError(
                f"{where}: found images of the exposures {levels} s, expected {expected} s; "
                "all frames of a sweep need the same."
            )
        fields: dict[str, Any] = {"i": number, "angle_deg": None if angle_deg is None else float(angle_deg)}
        fields |= {side: frame.entry for side, frame in frames.items()} | extra
        if placement is not None:
            fields["placement"] = int(placement)
        self.append_line(fields, {side: frame.images for side, frame in frames.items()})
        self._levels = expected
        return number

    def append_line(self, fields: Mapping[str, Any], images: Mapping[str, Sequence[np.ndarray]]) -> None:
        """Add one record from another journal; acquisition calls `append`.

        Args:
            fields: All of the record, `i` included. The names of its images are replaced.
            images: For "on" and "off" the images that the record names there, in its order; not
                copied, so they must not change any more.

        Raises:
            CaptureError: For the reasons of `append`.
        """
        self._check_alive()
        number = fields["i"]
        retakes = self._taken.get(number, 0)
        # A retake never changes images that the journal names.
        stem = f"{number:06d}" if retakes == 0 else f"{number:06d}-{retakes}"
        names = {side: self._store.names(side, stem, len(given)) for side, given in images.items() if given}
        record = {**fields, **{side: named(fields[side], given) for side, given in names.items()}}
        # A line that JSON cannot hold is refused before anything is written.
        self._line(record | self._sums({side: [_NO_DIGEST] * len(given) for side, given in names.items()}))
        for side, given in names.items():
            self._store.take(side, len(given))
        jobs = {
            side: [self._pool.submit(self._store.write, *one) for one in zip(given, images[side], strict=True)]
            for side, given in names.items()
        }
        self._taken[number] = retakes + 1
        self._next = max(self._next, number + 1)
        self._pending.append(_Pending(record, jobs))
        self._advance()

    def event(self, name: str, **extra: Any) -> None:
        """Add an event ("resume", "fault", ...), which readers skip, after all records so far."""
        self.append_event({"event": name, **extra})

    def append_event(self, fields: Mapping[str, Any]) -> None:
        """Add an event from another journal."""
        self._check_alive()
        self._line(dict(fields))
        self._pending.append(_Pending(dict(fields), {}))
        self._advance()

    def seal(self, **extra: Any) -> None:
        """Write all records so far, and the event "seal", which binds header and journal as they are then."""
        self.flush()
        self.event("seal", **extra, **seal(self.path))

    def flush(self) -> None:
        """Wait until all records so far are in the journal.

        Raises:
            CaptureError: If one cannot be written.
        """
        self._check_alive()
        while self._pending:
            self._complete_oldest()

    def close(self) -> None:
        """Write all pending records, and end.

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
            # A second failure is not raised.
            with contextlib.suppress(*(() if self._failed is None else (CaptureError,))):
                self._store.close()

    def __enter__(self) -> "CaptureWriter":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _check_alive(self) -> None:
        if self._failed is not None:
            raise self._failed
        if self._journal.closed:
            raise CaptureError(f"{self.path}: the capture is closed; nothing can be appended.")

    def _sums(self, digests: Mapping[str, Sequence[str]]) -> dict[str, Any]:
        """The key of a record that holds the sha256 of its images: one text a side, or a list of them."""
        if not self._digests:
            return {}
        return {"sha256": {side: sums[0] if len(sums) == 1 else list(sums) for side, sums in digests.items()}}

    def _line(self, fields: dict[str, Any]) -> bytes:
        return journal_line(fields, name=str(self.path))

    def _advance(self) -> None:
        """Complete finished records, and wait if too many are pending."""
        while len(self._pending) > self._ahead or (self._pending and self._pending[0].done()):
            self._complete_oldest()

    def _complete_oldest(self) -> None:
        pending = self._pending.popleft()
        try:
            digests = {side: [image.result() for image in images] for side, images in pending.images.items()}
            line = self._line(pending.fields | (self._sums(digests) if digests else {}))
            with reported(f"{self.path / JOURNAL_NAME}: cannot be written", error=CaptureError):
                append_whole(self._journal, line, durable=self._durable)
        except CaptureError as problem:
            self._failed = problem
            raise


def create_capture(
    path: str | Path,
    header: CaptureHeader,
    *,
    storage: Storage = "zstd",
    durable: bool = True,
    digests: bool = False,
) -> CaptureWriter:
    """Begin a new capture.

    Args:
        path: The folder; made if it does not exist.
        header: The contents of `capture.toml`.
        storage: "zstd", a file per image that is read ten times as fast as PNG (docs/formats.md); "png",
            a file per image that every program opens; or "npy", raw frames in shards of at most
            64 MiB and 32 frames, which take twice the space and are read without decoding.
        durable: Wait for the disk with every record, so that a loss of power costs only the last.
            A simulation, which can be run again, saves the time.
        digests: Note the sha256 of every image in its record, for `verify_capture`.

    Returns:
        The writer; use it in a `with` statement.

    Raises:
        CaptureError: If the folder exists and is not empty, or cannot be written.
    """
    path = Path(path)
    toml = header_toml(header)
    check_name(path, error=CaptureError)
    with reported(f"{path}: cannot be created", error=CaptureError):
        make_folder(path, durable=durable)
        require_no_links(path)
        if not is_unused(path):
            raise CaptureError(
                f"{path}: exists and is not empty; choose another folder, a capture is never overwritten."
            )
        for folder in ("on", "off"):
            make_folder(path / folder, own=path)
        open_to_append(path / JOURNAL_NAME).close()
        # Last: a folder with a header is a capture.
        write_atomically(path / HEADER_NAME, toml, durable=durable, error=CaptureError, links="replace")
        return CaptureWriter(path, header, settings=WriteSettings(storage, durable, digests))


def resume_capture(
    path: str | Path, *, storage: Storage | None = None, durable: bool = True, digests: bool = False
) -> CaptureWriter:
    """Append to an existing capture.

    A torn last line is removed, since lines will follow it, and the event "resume" is written.

    Args:
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
