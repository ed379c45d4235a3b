"""The images of a capture: read one by one, several for one frame joined, or decoded ahead into chunks."""

import hashlib
import math
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import CaptureHeader, frame_shape, image_limit
from jaxscan.files.capture.journal import Folder, ImageRef, Record
from jaxscan.files.capture.seals import difference, frame_digest
from jaxscan.files.capture.shards import Shards
from jaxscan.files.disk import read_bounded
from jaxscan.reconstruction import FrameChunk
from jaxscan.stripes import frame_rank, level_exposures


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
