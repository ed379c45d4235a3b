"""The cluster of this machine: each worker on cores of its own, also after a restart, and nothing left running."""

import os
import signal
import socket
import time

import psutil
import pytest

from jaxscan.errors import OptionError
from jaxscan.fleet import ClusterChoice, open_cluster
from jaxscan.fleet.clusters.pinning import share_of
from jaxscan.fleet.clusters.sizes import GIB, Sizes, sizes_for


def where_am_i(_=None):
    """Of a worker: its process, what each thread may use, what was loaded, and its environment."""
    import sys

    threads = [sorted(os.sched_getaffinity(int(thread))) for thread in os.listdir("/proc/self/task")]
    return os.getpid(), threads, "jax" in sys.modules, os.environ.get("JAXSCAN_TEST_WORD")


@pytest.fixture(scope="module")
def client():
    patch = pytest.MonkeyPatch()
    patch.setenv("JAXSCAN_TEST_WORD", "from the caller")
    with open_cluster(ClusterChoice(workers=2, memory_gib=0.5)) as client:
        yield client
    patch.undo()
    assert not [child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())]


def test_each_worker_has_its_share_of_the_cores_also_after_a_restart(client): ...
