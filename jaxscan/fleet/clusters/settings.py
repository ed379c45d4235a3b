"""What all kinds of clusters need: settings of Dask for work like ours, a clean environment, and waiting."""

import asyncio
import concurrent.futures
import contextlib
import os
from collections.abc import Coroutine, Iterator, Mapping
from typing import Any

from jaxscan.errors import OptionError


# Dask can write results to the disk when memory is short, or let a worker wait. Neither helps here: results are
# names and numbers, what takes the memory is arrays of a running task, and a worker that waits with them keeps them.
# So its nanny ends a worker that comes near its limit, starts another, and the task is tried again.
MEMORY: Mapping[str, Any] = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
}
NO_PAGE = "jaxscan.fleet.clusters.no_page"
"""The module that schedulers and workers load so that they serve no page."""
PAGELESS: Mapping[str, Any] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
"""Until that module is loaded, their pages have nothing to tell."""
# A worker gets one task at a time, so that none waits behind one that is long or that ends its worker. And a worker
# that dies gets a successor however long that takes to start: Dask would give it up after some seconds.
OURS: Mapping[str, Any] = {
    **MEMORY,
    **PAGELESS,
    "distributed.scheduler.preload": [NO_PAGE],
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.deploy.lost-worker-timeout": "1 day",
}
"""For clusters that are started for a batch."""
PINNING = "jaxscan.fleet.clusters.pinning"
"""The module that a worker loads before its work: it takes its share of the cores."""
LOOPBACK_PAGE = "127.0.0.1:0"
"""Where schedulers and workers serve pages until `NO_PAGE` is loaded."""


def as_environment(settings: Mapping[str, Any]) -> dict[str, str]:
    """Settings of Dask as the environment variables that say the same."""
    return {f"DASK_{name.replace('.', '__').replace('-', '_').upper()}": str(value) for name, value in settings.items()}


@contextlib.contextmanager
def kept_environment() -> Iterator[None]:
    """Nannies change variables of the process that they run in, for their workers; afterwards they are as before."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


def run_apart(work: Coroutine[Any, Any, Any]) -> Any:
    """The result of a coroutine, run in a thread of its own: in a notebook this one has a loop of events already."""
    with concurrent.futures.ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, work).result()


def wait_for_worker(client: Any, seconds: float, remedy: str) -> None:
    """Wait until the first worker is there.

    Raises:
        OptionError: If none comes in that time; its line ends with the remedy.
    """
    try:
        client.wait_for_workers(1, timeout=seconds)
    except TimeoutError as problem:
        raise OptionError(f"no worker came within {seconds:g} s; {remedy}") from problem
