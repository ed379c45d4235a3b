"""Decoding ahead: frames into chunks, in threads that never wait for the caller to compute."""

import os
import sys
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, runtime_checkable

import numpy as np

from jaxscan.reconstruction import FrameChunk


AHEAD = 2
"""Chunks in decoding, or decoded, while the caller computes with those it was given."""
_KEPT = 2 * (AHEAD + 4)


@runtime_checkable
class FrameSource(Protocol):
    """Where the laser-on, or the laser-off, frames of a sweep come from."""

    def mapped(self, start: int, stop: int) -> np.ndarray | None:
        """Frames of records start ... stop - 1 where they lie in memory in this order; else None."""
        ...

    def load(self, record: int, target: np.ndarray) -> None:
        """Fill `target` with one record's frame; called in threads."""
        ...


def decode_ahead(
    count: int, size: int, shape: tuple[int, ...], on: FrameSource, off: FrameSource | None
) -> Iterator[FrameChunk]:
    """Records 0 ... count - 1 in chunks, the next ones in decoding while the caller computes.

    At most `AHEAD` + 1 chunks exist beside those that the caller holds. A caller may keep what it
    was given; the memory of a chunk that nobody refers to any more, also not through a part of
    it, is used again, which saves the system the work of clearing 20 000 pages per chunk.

    Args:
        count: Number of records.
        size: Records in a chunk; the last may have fewer.
        shape: Of one record's frame.
        on: Laser-on frames.
        off: Laser-off frames, where there are.

    Yields:
        The chunks in order, read-only where nothing had to be copied. An error of a source is
        raised where its chunk would have come.
    """
    pool = ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-decode")
    buffers = Buffers((size, *shape))
    ahead: deque[tuple[FrameChunk, list[Future[None]]]] = deque()
    starts = deque(range(0, count, size))

    def begin(start: int) -> tuple[FrameChunk, list[Future[None]]]:
        stop = min(start + size, count)
        wanted: list[tuple[FrameSource, np.ndarray]] = []

        def frames(source: FrameSource) -> np.ndarray:
            mapped = source.mapped(start, stop)
            if mapped is not None:
                return mapped
            target = buffers.take()[: stop - start]
            wanted.append((source, target))
            return target

        chunk = FrameChunk(frames(on), None if off is None else frames(off))
        return chunk, [pool.submit(_load, wanted, start, row) for row in range(stop - start if wanted else 0)]

    try:
        while starts or ahead:
            while starts and len(ahead) <= AHEAD:
                ahead.append(begin(starts.popleft()))
            chunk, futures = ahead.popleft()
            for future in futures:
                future.result()
            del futures
            yield chunk
            # Else this frame would refer to it, and its memory could not be used again.
            del chunk
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _load(wanted: list[tuple[FrameSource, np.ndarray]], start: int, row: int) -> None:
    for source, target in wanted:
        source.load(start + row, target[row])


class Buffers:
    """Memory of one shape, used again when only this object refers to it."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._made: list[np.ndarray] = []
        # Every view of an array, however it was made, refers to the array that owns the memory.
        self._unused = _references([np.empty(0, np.uint8)], 0)

    def take(self) -> np.ndarray:
        """Memory with any content."""
        for number in range(len(self._made)):
            if _references(self._made, number) == self._unused:
                return self._made[number]
        buffer = np.empty(self._shape, np.uint8)
        if len(self._made) < _KEPT:
            self._made.append(buffer)
        return buffer


def _references(buffers: list[np.ndarray], number: int) -> int:
    return sys.getrefcount(buffers[number])


def cores() -> int:
    """Cores that this process may use: a container may own fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
