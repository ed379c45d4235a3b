"""Captures that are written: created, filled record by record, sealed, resumed, or copied into another storage."""

import contextlib
import hashlib
import io
import itertools
import math
import os
import re
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import (
    HEADER_NAME,
    HEADER_SEAL,
    JOURNAL_NAME,
    MAX_IMAGES,
    SEAL,
    SEALED_RECORDS,
    Capture,
    CaptureHeader,
    ImageRef,
    Record,
    cores,
    exposure_levels,
    frame_shape,
    header_toml,
    journal_line,
    journal_objects,
    open_capture,
    read_texts,
    seal,
)
from jaxscan.files.disk import (
    append_whole,
    check_name,
    make_folder,
    open_to_write,
    reported,
    sync_to_disk,
    whole_folder,
    write_atomically,
)
from jaxscan.geometry import MOTIONS
from jaxscan.stripes import split_levels


# Storage of images in a capture: a file each, packed by zstd or as PNG, or raw frames in shards.


Storage = Literal["zstd", "png", "npy"]
STORAGES: tuple[Storage, ...] = get_args(Storage)

SHARD_BYTES = 64 << 20
SHARD_RECORDS = 32
# NumPy's own header of a few frames has this length, whatever their number.
_HEADER_BYTES = 128


@dataclass(frozen=True)
class WriteSettings:
    """How a capture is written; `create_capture` describes each."""

    storage: Storage = "zstd"
    durable: bool = True
    digests: bool = False


class FileStore:
    """One file per image, named after the record.

    As in `ShardStore`, one thread calls `names` and `take`, and many call `write`.
    """

    def __init__(self, path: Path, settings: WriteSettings) -> None:
        self._path, self._settings = path, settings
        self._suffix = ".png" if settings.storage == "png" else ".zst"

    def names(self, side: str, stem: str, count: int) -> list[str]:
        stems = [stem] if count == 1 else [f"{stem}_{k}" for k in range(count)]
        return [f"{side}/{one}{self._suffix}" for one in stems]

    def take(self, side: str, count: int) -> None:
        pass

    def write(self, name: str, image: np.ndarray) -> str:
        # Here, so that reading a capture's header does not load OpenCV.
        from jaxscan.vision import encode_png, encode_zstd

        data = encode_png(image) if self._suffix == ".png" else encode_zstd(image)
        durable = self._settings.durable
        write_atomically(self._path / name, data, durable=durable, error=CaptureError, links="replace")
        return hashlib.sha256(data).hexdigest() if self._settings.digests else ""

    def close(self) -> None:
        pass


class _Place(NamedTuple):
    shard: int
    used: int
    length: int


class ShardStore:
    """Shards `on/000000.npy`, `off/000000.npy`, ... of raw frames, in the order in which they are appended.

    A shard has its full length from the beginning, and images are written into it one by one; so
    it is readable at any moment, and every frame that the journal names in it is complete. Shards
    of an earlier session are never changed.
    """

    def __init__(self, path: Path, shape: tuple[int, ...], durable: bool, digests: bool) -> None:
        self._path, self._shape, self._durable, self._digests = path, shape, durable, digests
        self._bytes = int(np.prod(shape, dtype=np.int64))
        self._place = {side: _Place(_last_shard(path / side), 0, 0) for side in ("on", "off")}
        self._length: dict[str, int] = {}
        self._made: set[str] = set()
        self._lock = threading.Lock()

    def names(self, side: str, stem: str, count: int) -> list[str]:
        """References for `count` images of one frame; `side` is "on" or "off". Changes nothing."""
        place = self._room(side, count)
        return [f"{_shard_name(side, place.shard)}#{place.used + k}" for k in range(count)]

    def take(self, side: str, count: int) -> None:
        """Reserve those names."""
        place = self._room(side, count)
        self._place[side] = place._replace(used=place.used + count)
        self._length[_shard_name(side, place.shard)] = place.length

    def _room(self, side: str, count: int) -> _Place:
        """Start a frame: all its images go into one shard, so that chunks of frames can be mapped."""
        place = self._place[side]
        if place.used + count <= place.length:
            return place
        frames = min(SHARD_RECORDS, max(1, SHARD_BYTES // (count * self._bytes)))
        # A power of two, so that chunks of another power of two never need parts of two shards.
        return _Place(place.shard + 1, 0, count * (1 << (frames.bit_length() - 1)))

    def write(self, name: str, image: np.ndarray) -> str:
        """Write an image under its name; after this the journal may name it.

        Returns:
            The sha256 of the image as it is stored, in hexadecimal digits; "" without `digests`.
        """
        shard, _, index = name.partition("#")
        with reported(f"{self._path / shard}: cannot be written", error=CaptureError):
            with self._lock:
                self._make(shard)
            with open_to_write(self._path / shard, "change") as file:
                file.seek(_HEADER_BYTES + int(index) * self._bytes)
                data = np.ascontiguousarray(image).reshape(-1).data
                digest = hashlib.sha256(data).hexdigest() if self._digests else ""
                while data:
                    data = data[file.write(data) :]
                if self._durable:
                    os.fsync(file.fileno())
        return digest

    def _make(self, shard: str) -> None:
        if shard in self._made:
            return
        file = self._path / shard
        with open_to_write(file, "make") as made:
            append_whole(made, _header(self._length[shard], self._shape), durable=False)
            made.truncate(_HEADER_BYTES + self._length[shard] * self._bytes)
        if self._durable:
            sync_to_disk(file)
            sync_to_disk(file.parent)
        self._made.add(shard)

    def close(self) -> None:
        """Shorten the last shards to their frames, after all calls of `write` have returned."""
        for side, place in self._place.items():
            shard = _shard_name(side, place.shard)
            if shard not in self._made or place.used >= place.length:
                continue
            file_path = self._path / shard
            with (
                reported(f"{file_path}: cannot be written", error=CaptureError),
                open_to_write(file_path, "change") as file,
            ):
                # The header shrinks before the file, so the file is readable at any moment. The disk writes over a
                # few bytes in one go.
                file.write(_header(place.used, self._shape))
                if self._durable:
                    os.fsync(file.fileno())
                file.truncate(_HEADER_BYTES + place.used * self._bytes)


def image_store(path: Path, shape: tuple[int, ...], settings: WriteSettings) -> FileStore | ShardStore:
    """The store for images of `shape` in the capture at `path`.

    With `digests`, `write` returns the sha256 of the file, or of the frame in a shard.
    """
    if settings.storage not in STORAGES:
        raise ValueError(f"Unknown storage {settings.storage!r}; known: {', '.join(STORAGES)}.")
    if settings.storage == "npy":
        return ShardStore(path, shape, settings.durable, settings.digests)
    return FileStore(path, settings)


def _shard_name(side: str, number: int) -> str:
    return f"{side}/{number:06d}.npy"


def _last_shard(folder: Path) -> int:
    """The largest number of a shard; -1 if there is none."""
    names = os.listdir(folder) if os.path.isdir(folder) else []
    found = (re.fullmatch(r"([0-9]{6,9})\.npy", name) for name in names)
    return max((int(match[1]) for match in found if match), default=-1)


def _header(length: int, shape: Sequence[int]) -> bytes:
    """The beginning of an `.npy` file of uint8 [length, *shape], of the same size for every length."""
    text = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        text, {"descr": "|u1", "fortran_order": False, "shape": (length, *map(int, shape))}
    )
    found = text.getvalue()
    if len(found) != _HEADER_BYTES:
        raise CaptureError(f"NumPy's header has {len(found)} bytes, expected {_HEADER_BYTES}.")
    return found


# A capture that is written: created, filled record by record, sealed or resumed.

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
        self._journal = open_to_write(path / JOURNAL_NAME, "append")
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
        open_to_write(path / JOURNAL_NAME, "append").close()
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


# Copying a capture with its images stored in another way: packed, as PNG files, or as raw frames in shards.


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
