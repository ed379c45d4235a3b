"""Several chunks at a time, results in order."""

import itertools
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np

from jaxscan.geometry import Array
from jaxscan.stripes.shifted import Frames, Shifted


Item = TypeVar("Item")
Result = TypeVar("Result")


def workers() -> int:
    """Chunks computed at a time.

    XLA's code for the CPU spends most of its time on one core, so each core takes a chunk of its
    own; an accelerator needs only that the next chunk is copied while it computes.
    """
    return (os.cpu_count() or 1) if jax.default_backend() == "cpu" else 2


def map_ahead(compute: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    """`map` in order, by threads, never with more than one item in memory beyond the workers."""
    waiting = iter(items)
    # The first by itself: what compiles, compiles once.
    yield from (compute(item) for item in itertools.islice(waiting, 1))
    with ThreadPoolExecutor(workers) as pool:
        running: deque[Future[Result]] = deque()
        for item in waiting:
            running.append(pool.submit(compute, item))
            if len(running) > workers:
                yield running.popleft().result()
        while running:
            yield running.popleft().result()


_ALIGNMENT = 64
"""Address of an array that JAX takes on a CPU without a copy, and of a cache line [bytes]."""


class Lender(threading.local):
    """Lends NumPy frames to JAX without the copy that it makes of most arrays.

    Where the frames are part of a larger array, so is the aligned memory around them; else they
    are copied to memory that is kept, since the pages of new memory cost more than the copy.
    Every thread has its own.
    """

    def __init__(self) -> None:
        self._kept: dict[str, np.ndarray] = {}

    def lend(self, name: str, frames: Array) -> Frames:
        """The frames; good until the next of that name are lent."""
        if not isinstance(frames, np.ndarray) or jax.default_backend() != "cpu":
            return frames
        lead = frames.ctypes.data % _ALIGNMENT
        if lead == 0 and frames.nbytes % _ALIGNMENT == 0 and frames.flags.c_contiguous:
            return frames
        length = frames.nbytes + _ALIGNMENT
        whole = frames.base
        if isinstance(whole, np.ndarray) and whole.flags.c_contiguous and frames.flags.c_contiguous:
            start = frames.ctypes.data - whole.ctypes.data - lead
            if start >= 0 and start + length <= whole.nbytes:
                memory = whole.reshape(-1).view(np.uint8)[start : start + length]
                return Shifted(memory, np.asarray(lead, np.int32), frames.shape)
        memory = self._memory(name, length)
        memory[: frames.nbytes] = frames.reshape(-1)
        return Shifted(memory, np.asarray(0, np.int32), frames.shape)

    def _memory(self, name: str, length: int) -> np.ndarray:
        kept = self._kept.get(name)
        if kept is None or len(kept) < length + _ALIGNMENT:
            kept = self._kept[name] = np.zeros(length + _ALIGNMENT, np.uint8)
        start = -kept.ctypes.data % _ALIGNMENT
        return kept[start : start + length]
