"""What Dask loads into each process of a cluster before the first task: `--preload jaxscan.fleet.preload`.

It closes the HTTP server of a scheduler or a worker. Dask's pages ask for no password, and even without its dashboard
they show names of captures, paths and machines to everybody who can connect.

It gives each of several workers on one machine its own cores. JAX starts as many threads as its process may use cores,
at its first computation, which comes later: so no two workers wait for each other.
"""

import os
import signal

import distributed


WORKERS = "JAXSCAN_WORKERS"
"""The environment variable with the number of workers that share the machine."""


def dask_setup(node: distributed.Scheduler | distributed.Worker) -> None:
    """Called by Dask in the process of a scheduler or a worker."""
    node.http_server.stop()
    if isinstance(node, distributed.Worker):
        # Ctrl-C at a terminal reaches all processes that were started there. The caller answers it, and ends its
        # workers.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _pin(str(node.name))


def share_of(number: int, workers: int, cores: set[int]) -> set[int]:
    """The cores of worker `number` of `workers`: every workers-th; with more workers than cores, some share one."""
    numbered = sorted(cores)
    return set(numbered[number % len(numbered) :: workers])


def _pin(name: str) -> None:
    """Bind all threads of this process to the cores of its worker, whose name ends with its number."""
    workers = int(os.environ.get(WORKERS, "1"))
    # Only Linux and a few others can; elsewhere the system shares out the cores.
    if workers < 2 or not hasattr(os, "sched_setaffinity"):
        return
    share = share_of(int(name.rpartition("-")[2]), workers, os.sched_getaffinity(0))
    # Each thread has its own set; a thread that starts later inherits that of the thread that starts it.
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), share)
