"""The images of a capture: files and frames of shards, read one by one, joined, or decoded ahead into chunks."""

import contextlib
import hashlib
import math
import mmap
import os
import re
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import CaptureHeader, frame_shape, image_limit
from jaxscan.files.capture.journal import Folder, ImageRef, Record
from jaxscan.files.disk import NPY_DAMAGE, open_regular, read_bounded, read_npy_header
from jaxscan.reconstruction import FrameChunk
from jaxscan.stripes import frame_rank, level_exposures


# Each keeps a file open, of which a process may have about a thousand.
_MAPPED = 32


class _Shard(NamedTuple):
    frames: np.ndarray
    file: mmap.mmap
    start: int
    """Offset of the first frame in the file [bytes]."""


class Shards:
    """The shards of one capture: checked when it is opened, mapped while they are read."""

    def __init__(self, folder: Path, shape: tuple[int, ...]) -> None:
        """`shape` is the shape of one frame."""
        self._path, self._folder, self._shape = folder, Folder(folder), shape
        self._length: dict[str, int] = {}
        self._mapped: OrderedDict[str, _Shard] = OrderedDict()
        self._lock = threading.Lock()

    def check(self, reference: ImageRef, located: Path) -> None:
        """Check that a shard has frames of the right size and is long enough."""
        if reference.path not in self._length:
            self._length[reference.path] = len(_open_shard(located, name=reference.path, shape=self._shape).frames)
        self._reaches(reference, self._length[reference.path])

    def image(self, reference: ImageRef) -> np.ndarray:
        """One frame, uint8 [rows, columns(, 3)]: a read-only view of the file."""
        frames = self._open(reference.path).frames
        self._reaches(reference, len(frames))
        return frames[reference.index]

    def run(self, references: Sequence[ImageRef]) -> np.ndarray | None:
        """Frames that lie one after another in one shard, uint8 [frames, rows, columns(, 3)]; else None.

        Nothing is copied: the result is a read-only view of the file, and is being read ahead.
        """
        first, last = references[0], references[-1]
        if first.index is None or last.index != first.index + len(references) - 1:
            return None
        if any(one.path != first.path or one.index != k for k, one in enumerate(references, first.index)):
            return None
        shard = self._open(first.path)
        self._reaches(last, len(shard.frames))
        frames = shard.frames[first.index : first.index + len(references)]
        if not frames.flags.c_contiguous:
            return None
        _read_ahead(shard.file, shard.start + first.index * frames[0].nbytes, frames.nbytes)
        return frames

    def _reaches(self, reference: ImageRef, length: int) -> None:
        if reference.index is None or reference.index >= length:
            raise CaptureError(f"{reference}: the shard has only {length} images.")

    def _open(self, path: str) -> _Shard:
        with self._lock:
            shard = self._mapped.pop(path, None)
            if shard is None:
                name = str(self._path / path)
                try:
                    located = self._folder.locate(ImageRef(path))
                except CaptureError as problem:
                    raise CaptureError(f"{self._path}/{problem}") from problem
                shard = _open_shard(located, name=name, shape=self._shape)
            # A shard that is dropped here stays mapped as long as a view of it is in use.
            self._mapped[path] = shard
            while len(self._mapped) > _MAPPED:
                self._mapped.popitem(last=False)
            return shard


def _open_shard(path: Path, *, name: str, shape: tuple[int, ...]) -> _Shard:
    """A shard, memory-mapped."""
    try:
        with open_regular(path, error=CaptureError, links="refuse") as file:
            found, column_major, dtype = read_npy_header(file)
            start = file.tell()
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if dtype != np.uint8 or found[1:] != shape or len(found) != 1 + len(shape):
            expected = " x ".join(map(str, shape))
            raise CaptureError(f"{name}: found {dtype} with shape {found}, expected uint8 with shape (n, {expected}).")
        count = math.prod(found)
        _check_length(mapped, start, count, math.prod(shape), name)
        # `frombuffer` refuses an empty buffer.
        frames = np.frombuffer(mapped, np.uint8, count, start) if count else np.empty(0, np.uint8)
        return _Shard(frames.reshape(found, order="F" if column_major else "C"), mapped, start)
    except NPY_DAMAGE as problem:
        raise CaptureError(f"{name}: not a readable .npy file: {problem}.") from problem


def _check_length(mapped: mmap.mmap, start: int, count: int, frame: int, name: str) -> None:
    """Check that a shard has the length that its header announces: a byte too many moves all images behind it."""
    surplus = len(mapped) - start - count
    # A program that is stopped while it shortens a shard, between header and file, leaves room for whole frames.
    room = surplus >= 0 and surplus % frame == 0 and not np.frombuffer(mapped, np.uint8, offset=start + count).any()
    if surplus != 0 and not room:
        found, expected = len(mapped), start + count
        raise CaptureError(f"{name}: not a readable .npy file: found {found} bytes, its header announces {expected}.")


def _read_ahead(file: mmap.mmap, begin: int, size: int) -> None:
    """Advise the system to read a part of a file ahead, where it takes such advice."""
    if hasattr(mmap, "MADV_WILLNEED"):
        page = begin // mmap.PAGESIZE * mmap.PAGESIZE
        with contextlib.suppress(OSError, ValueError):
            file.madvise(mmap.MADV_WILLNEED, page, begin + size - page)


Load = Callable[[ImageRef, np.ndarray | None], np.ndarray]


def exposure_levels(images: Sequence[ImageRef]) -> tuple[float, ...]:
    """The different exposures of a frame [s], ascending; empty where the record names none."""
    return tuple(sorted({one.exposure_s for one in images if one.exposure_s is not None}))


def check_exposures(records: Sequence[Record], *, name: str, bits: int | None = None) -> None:
    """Check that all frames of a capture have the same exposures.

    Args:
        records: All its records.
        bits: Bits of a sample, where frames are kept as levels.
    """
    expected = exposure_levels(records[0].on or records[0].off)
    if bits is not None and not np.array_equal(expected, level_exposures(bits)):
        raise CaptureError(
            f"{name}: record {records[0].i}: found {_levels(expected)}, but the header has bits = {bits}: expected the "
            f"relative exposures {', '.join(f'{one:g}' for one in level_exposures(bits))} of its levels."
        )
    for record in records:
        for side, images in (("on", record.on), ("off", record.off)):
            if images and exposure_levels(images) != expected:
                raise CaptureError(
                    f"{name}: record {record.i}: {side}: found {_levels(exposure_levels(images))}, but the "
                    f"capture began with {_levels(expected)}; all its frames need the same exposures."
                )


def load_levels(images: Sequence[ImageRef], target: np.ndarray, load: Load) -> None:
    """Read a frame, exposures ascending, and average repetitions.

    Args:
        images: Images of the frame.
        target: uint8 [exposures, rows, columns(, 3)], filled.
        load: Reads one image, into the memory that it is given or elsewhere.
    """
    levels = exposure_levels(images)
    for row, level in zip(target, levels, strict=True) if levels else [(target[0], None)]:
        average([one for one in images if one.exposure_s == level], row, load)


def average(images: Sequence[ImageRef], target: np.ndarray, load: Load) -> None:
    """The mean of images, rounded to whole DN, halves to even so that the rounding has no bias.

    Args:
        images: One or more.
        target: uint8 [rows, columns(, 3)], filled.
        load: Reads one image, into the memory that it is given or elsewhere.
    """
    if len(images) == 1:
        found = load(images[0], target)
        if found is not target:
            target[...] = found
        return
    # The sum of 16 images of 255 DN fits; in float32 the mean is exact where it is a half.
    total = np.zeros(target.shape, np.uint16)
    for one in images:
        total += load(one, None)
    target[...] = np.rint(total / np.float32(len(images)))


def _levels(levels: Sequence[float]) -> str:
    return "one image without exposure" if not levels else ", ".join(f"{1e3 * level:g}" for level in levels) + " ms"


AHEAD = 2
"""Chunks that are decoded ahead while the caller computes."""
_ALIGNED = 64


Look = Callable[[int, np.ndarray, np.ndarray | None], None]
"""Sees a record and its frames, laser on and laser off, in any order and in threads; keeps no frame."""


def decode_ahead(
    count: int,
    size: int,
    shape: tuple[int, ...],
    on: "RecordFrames",
    off: "RecordFrames | None",
    look: Look | None = None,
) -> Iterator[FrameChunk]:
    """Records 0 ... count - 1 in chunks, the next ones in decoding while the caller computes.

    At most `AHEAD` + 1 chunks exist beside those that the caller holds.

    Args:
        count: Number of records.
        size: Records in a chunk; the last may have fewer.
        shape: Shape of one record's frame.
        on: Laser-on frames.
        off: Laser-off frames, if there are any.
        look: Sees all frames while they are in the processor's caches.

    Yields:
        The chunks in order, read-only if nothing had to be copied. An error of a source is raised in place
        of its chunk.
    """
    pool = ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-decode")
    ahead: deque[tuple[FrameChunk, list[Future[None]]]] = deque()
    starts = deque(range(0, count, size))

    def begin(start: int) -> tuple[FrameChunk, list[Future[None]]]:
        stop = min(start + size, count)
        wanted: list[tuple[RecordFrames, np.ndarray, bool]] = []
        for source in (on, off):
            if source is not None:
                mapped = source.mapped(start, stop)
                frames = _aligned((stop - start, *shape)) if mapped is None else mapped
                wanted.append((source, frames, mapped is None))
        chunk = FrameChunk(wanted[0][1], wanted[1][1] if off is not None else None)
        return chunk, [pool.submit(_prepare, wanted, start + row, row, look) for row in range(stop - start)]

    try:
        while starts or ahead:
            while starts and len(ahead) <= AHEAD:
                ahead.append(begin(starts.popleft()))
            chunk, futures = ahead.popleft()
            for future in futures:
                future.result()
            del futures
            yield chunk
            # The generator itself holds on to no chunk.
            del chunk
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _prepare(wanted: list[tuple["RecordFrames", np.ndarray, bool]], record: int, row: int, look: Look | None) -> None:
    for source, frames, empty in wanted:
        if empty:
            source.load(record, frames[row])
        else:
            source.examine(record)
    if look is not None:
        on, *off = (frames[row] for _, frames, _ in wanted)
        look(record, on, off[0] if off else None)


def _aligned(shape: tuple[int, ...]) -> np.ndarray:
    """An array of uint8 with arbitrary contents, at a multiple of `_ALIGNED`: JAX takes it without a copy on a CPU."""
    memory = np.empty(math.prod(shape) + 2 * _ALIGNED, np.uint8)
    start = -memory.ctypes.data % _ALIGNED
    return memory[start : start + math.prod(shape)].reshape(shape)


def cores() -> int:
    """Number of cores that this process may use; in a container it may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def frame_digest(frame: np.ndarray) -> str:
    """The sha256 of a frame in a shard, in hexadecimal digits."""
    # Hashed as it lies in memory, without a copy where its rows follow each other.
    return hashlib.sha256(np.ascontiguousarray(frame).reshape(-1).data).hexdigest()


def difference(image: ImageRef, found: str) -> str | None:
    """How the digest of an image differs from that in its record; None if they agree or the record has none."""
    if image.sha256 is None:
        return None
    if not re.fullmatch("[0-9a-f]{64}", image.sha256):
        return f"found {image.sha256!a:.40} in its record, expected a sha256"
    return None if found == image.sha256 else f"found the sha256 {found[:12]}…, expected {image.sha256[:12]}…"


class ImageReader:
    """Reads images of one capture; used from several threads."""

    def __init__(self, path: Path, header: CaptureHeader, *, compare: bool = True) -> None:
        self._path, self._header, self._folder = path, header, Folder(path)
        self.compared = compare
        """Whether images are compared with their digests."""
        self.shape = frame_shape(header)
        """Shape of one image: (rows, columns), or (rows, columns, 3)."""
        self.shards = Shards(path, self.shape)
        self._records: Sequence[Record] = ()

    def check(self, records: Sequence[Record]) -> None:
        """Check that every image exists inside the folder, and that the shards are long enough.

        Raises:
            CaptureError: With the record and the file.
        """
        self._records = records
        located = dict[str, Path]()
        for record, reference in ((one, image) for one in records for image in (*one.on, *one.off)):
            if reference.index is None and self._folder.holds(reference.path):
                continue
            try:
                # Many images share a shard.
                if reference.path not in located:
                    located[reference.path] = self._folder.locate(reference)
                if reference.index is not None:
                    self.shards.check(reference, located[reference.path])
            except CaptureError as problem:
                raise CaptureError(f"{self._path}: record {record.i}: {problem}") from problem

    def image(self, reference: ImageRef, out: np.ndarray | None = None) -> np.ndarray:
        """One image as it is stored, uint8 [rows, columns(, 3)]; a read-only view where it is in a shard.

        Args:
            out: Memory of its shape for it, which is used, and returned, where the file has to be decoded.

        Raises:
            CaptureError: With the name of the file that is missing, damaged, of the wrong size, or no longer the one
                whose digest its record holds.
        """
        if reference.index is not None:
            frame = self.shards.image(reference)
            if self.compared and reference.sha256 is not None:
                self._compare(reference, frame_digest(frame))
            return frame
        # Here, so that opening a capture does not load OpenCV.
        from jaxscan.vision import decode_image

        camera = self._header.camera
        name = str(self._path / reference.path)
        try:
            located = self._folder.locate(reference)
        except CaptureError as problem:
            raise CaptureError(f"{self._path}/{problem}") from problem
        data = read_bounded(located, image_limit(self._header), error=CaptureError, links="refuse")
        if self.compared and reference.sha256 is not None:
            self._compare(reference, hashlib.sha256(data).hexdigest())
        size = camera.width, camera.height
        return decode_image(data, name=name, rank=frame_rank(camera.pixel_format), size=size, out=out)

    def _compare(self, reference: ImageRef, digest: str) -> None:
        found = difference(reference, digest)
        if found is None:
            return
        images = ((record.i, one) for record in self._records for one in (*record.on, *record.off))
        number = next((f"record {i}: " for i, one in images if one == reference), "")
        raise CaptureError(
            f"{self._path}: {number}{reference}: {found}; the file has changed since it was written: jaxscan doctor "
            "--capture lists all changes; restore the file from a copy; records of jaxscan scan are taken again by "
            "--resume."
        )

    def frame(self, images: Sequence[ImageRef]) -> np.ndarray | None:
        """One frame of a record, a copy: uint8 [rows, columns(, 3)], of a bracket [exposures, rows, columns(, 3)]."""
        if not images:
            return None
        levels = max(1, len(exposure_levels(images)))
        target = np.empty((levels, *self.shape), np.uint8)
        load_levels(images, target, self.image)
        return target[0] if levels == 1 else target


class RecordFrames:
    """The laser-on, or the laser-off, frames of a sweep; `examine` and `load` are called in threads."""

    def __init__(self, reader: ImageReader, images: Sequence[tuple[ImageRef, ...]]) -> None:
        """`images` has the images of each record; all records have the same exposures."""
        self._reader = reader
        self._images = images
        self._levels = max(1, len(exposure_levels(images[0]))) if images else 1

    def mapped(self, start: int, stop: int) -> np.ndarray | None:
        """The frames of records start ... stop - 1, a view, where they lie one after another in one shard."""
        if any(len(one) != self._levels for one in self._images[start:stop]):
            return None
        flat = [image for one in self._images[start:stop] for image in _ascending(one)]
        found = self._reader.shards.run(flat)
        if found is None or self._levels == 1:
            return found
        return found.reshape(stop - start, self._levels, *self._reader.shape)

    def examine(self, record: int) -> None:
        """Compare one record's frame, which is mapped, with its digests."""
        for image in self._images[record]:
            if image.sha256 is not None:
                self._reader.image(image)

    def load(self, record: int, target: np.ndarray) -> None:
        """One record's frame into `target`."""
        load_levels(self._images[record], target if self._levels > 1 else target[None], self._reader.image)


def _ascending(images: tuple[ImageRef, ...]) -> Sequence[ImageRef]:
    return images if len(images) == 1 else sorted(images, key=lambda one: one.exposure_s or 0.0)
