"""Gives each worker cores of its own. Dask loads it in every worker's process, also in one that follows a dead one.

JAX starts as many threads as there are cores that a process may use, at its first work, which comes later. So each
worker has the threads of its own share, and no two wait for each other.
"""

import os
import signal
from typing import Any


WORKERS = "JAXSCAN_WORKERS"
"""The environment variable that says how many workers share the machine."""


def share_of(number: int, workers: int, cores: set[int]) -> set[int]:
    """The cores of worker `number` of `workers`: every workers-th; with more workers than cores, one shared by some."""
    numbered = sorted(cores)
    return set(numbered[number % len(numbered) :: workers])


def dask_setup(worker: Any) -> None:
    """Called by Dask in the worker's process before its first task."""
    # Ctrl-C at a terminal reaches all processes that were started there. The caller answers it, and ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    workers = int(os.environ.get(WORKERS, "1"))
    # Only Linux and a few others can; elsewhere the system shares out the cores.
    if workers < 2 or not hasattr(os, "sched_setaffinity"):
        return
    number = int(str(worker.name).rpartition("-")[2])
    share = share_of(number, workers, os.sched_getaffinity(0))
    # Each thread has its own set; those that start later have that of the thread that starts them.
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), share)
