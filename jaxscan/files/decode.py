"""Decoding ahead: frames into preallocated chunks, in threads, while the caller computes."""

import itertools
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from jaxscan.reconstruction.sweep import FrameChunk


def decode_ahead(
    count: int, size: int, shape: tuple[int, ...], with_off: bool, load: Callable[[int, FrameChunk, int], None]
) -> Iterator[FrameChunk]:
    """Records 0 ... count - 1 in chunks, the next chunk in decoding while this one is used.

    At most three chunks exist at a time: the one the caller still holds, the one it is about to
    get, and the one after. Each has memory of its own, so a caller may keep what it was given.

    Args:
        count: Number of records.
        size: Records in a chunk; the last may have fewer.
        shape: Of one frame.
        with_off: Whether there are laser-off frames.
        load: `load(record, chunk, row)` fills row `row` of the chunk; called in threads.

    Yields:
        The chunks in order. An error of `load` is raised where its chunk would have come.
    """

    def begin(start: int) -> tuple[FrameChunk, list[Future[None]]]:
        rows = min(size, count - start)
        on = np.empty((rows, *shape), np.uint8)
        chunk = FrameChunk(on, np.empty_like(on) if with_off else None)
        return chunk, [pool.submit(load, start + row, chunk, row) for row in range(rows)]

    pool = ThreadPoolExecutor(_cores(), thread_name_prefix="jaxscan-decode")
    ahead: deque[tuple[FrameChunk, list[Future[None]]]] = deque()
    try:
        starts = iter(range(0, count, size))
        ahead.extend(begin(start) for start in itertools.islice(starts, 1))
        while ahead:
            ahead.extend(begin(start) for start in itertools.islice(starts, 1))
            chunk, futures = ahead.popleft()
            for future in futures:
                future.result()
            del futures
            yield chunk
            del chunk
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _cores() -> int:
    # A container may own fewer cores than the machine has.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
