"""Several chunks at a time, results in order."""

import itertools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import jax


Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[int, int], None] | None
"""Called with (records done, records in all)."""


def workers() -> int:
    """Chunks computed at a time.

    XLA's code for the CPU spends most of its time on one core, so each core takes a chunk of its
    own; an accelerator needs only that the next chunk is copied while it computes.
    """
    return (os.cpu_count() or 1) if jax.default_backend() == "cpu" else 2


def map_ahead(
    compute: Callable[[Item], Result], items: Iterable[Item], workers: int, *, compiled: bool = False
) -> Iterator[Result]:
    """`map` in order, by threads, never with more than one item in memory beyond the workers."""
    waiting = iter(items)
    # The first by itself, unless `compiled`, so that threads do not compile the same function twice.
    yield from (compute(item) for item in itertools.islice(waiting, 0 if compiled else 1))
    with ThreadPoolExecutor(workers) as pool:
        running: deque[Future[Result]] = deque()
        for item in waiting:
            running.append(pool.submit(compute, item))
            if len(running) > workers:
                yield running.popleft().result()
        while running:
            yield running.popleft().result()
