"""Decoding ahead: threads decode frames into chunks while the caller computes."""

import math
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, runtime_checkable

import numpy as np

from jaxscan.reconstruction import FrameChunk


AHEAD = 2
"""Chunks that are decoded ahead while the caller computes."""
_KEPT = 2 * (AHEAD + 4)
_ALIGNED = 64
"""[bytes]."""


Look = Callable[[int, np.ndarray, np.ndarray | None], None]
"""Sees a record and its frames, laser on and laser off, in any order and in threads; keeps no frame."""


@runtime_checkable
class FrameSource(Protocol):
    """Source of the laser-on, or the laser-off, frames of a sweep."""

    def mapped(self, start: int, stop: int) -> np.ndarray | None:
        """Frames of records start ... stop - 1 where they lie in memory in this order; else None."""
        ...

    def examine(self, record: int) -> None:
        """Raise if a record's mapped frame is not as it was written; called in threads."""
        ...

    def load(self, record: int, target: np.ndarray) -> None:
        """Fill `target` with one record's frame; called in threads."""
        ...


def decode_ahead(
    count: int,
    size: int,
    shape: tuple[int, ...],
    on: FrameSource,
    off: FrameSource | None,
    look: Look | None = None,
) -> Iterator[FrameChunk]:
    """Records 0 ... count - 1 in chunks, the next ones in decoding while the caller computes.

    At most `AHEAD` + 1 chunks exist beside those that the caller holds. A caller may keep a chunk. When
    neither the chunk nor a part of it is referred to any more, its memory is used again: this spares the
    system the clearing of 20 000 pages per chunk.

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
    buffers = Buffers((size, *shape))
    ahead: deque[tuple[FrameChunk, list[Future[None]]]] = deque()
    starts = deque(range(0, count, size))

    def begin(start: int) -> tuple[FrameChunk, list[Future[None]]]:
        stop = min(start + size, count)
        wanted: list[tuple[FrameSource, np.ndarray, bool]] = []
        for source in (on, off):
            if source is not None:
                mapped = source.mapped(start, stop)
                frames = buffers.take()[: stop - start] if mapped is None else mapped
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
            # Drop the reference of this function, so that the memory can be used again.
            del chunk
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _prepare(wanted: list[tuple[FrameSource, np.ndarray, bool]], record: int, row: int, look: Look | None) -> None:
    for source, frames, empty in wanted:
        if empty:
            source.load(record, frames[row])
        else:
            source.examine(record)
    if look is not None:
        on, *off = (frames[row] for _, frames, _ in wanted)
        look(record, on, off[0] if off else None)


class Buffers:
    """Arrays of one shape; each is used again when only this object refers to it.

    They begin at a multiple of `_ALIGNED` and have so much room behind them: JAX takes them without a copy on a CPU.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._made: list[np.ndarray] = []
        # Every view refers to the array that owns the memory.
        self._unused = _references([np.empty(0, np.uint8)], 0)

    def take(self) -> np.ndarray:
        """An array with arbitrary contents."""
        for number in range(len(self._made)):
            if _references(self._made, number) == self._unused:
                return self._within(self._made[number])
        memory = np.empty(math.prod(self._shape) + 2 * _ALIGNED, np.uint8)
        if len(self._made) < _KEPT:
            self._made.append(memory)
        return self._within(memory)

    def _within(self, memory: np.ndarray) -> np.ndarray:
        start = -memory.ctypes.data % _ALIGNED
        return memory[start : start + math.prod(self._shape)].reshape(self._shape)


def _references(buffers: list[np.ndarray], number: int) -> int:
    return sys.getrefcount(buffers[number])


def cores() -> int:
    """Number of cores that this process may use; in a container it may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
