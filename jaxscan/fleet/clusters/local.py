"""A cluster of this machine's cores, for as long as the command runs."""

import contextlib
import logging
import math
import os
import sys
from collections.abc import Iterator
from typing import Any

import dask
import distributed
import psutil
from dask.system import CPU_COUNT
from distributed.system import MEMORY_LIMIT

from jaxscan.fleet.clusters.certificates import new_certificates, security_of
from jaxscan.fleet.clusters.choice import ClusterChoice
from jaxscan.fleet.clusters.pinning import WORKERS
from jaxscan.fleet.clusters.settings import LOOPBACK_PAGE, NO_PAGE, OURS, PINNING, kept_environment
from jaxscan.fleet.clusters.sizes import GIB, sizes_for


_HOST = "127.0.0.1"
_QUIET = "ignore:resource_tracker"


@contextlib.contextmanager
def open_local(choice: ClusterChoice) -> Iterator[Any]:
    """Workers on this machine, each with its share of the cores and of the memory.

    Everybody with an account on a machine can connect to its loopback, so here too only who holds the certificate is
    heard. It is in the memory of these processes alone.

    Raises:
        OptionError: If the memory is too little for what is asked for.
    """
    sizes = sizes_for(choice.workers, choice.memory_gib, cores=cores(), free_gib=free_memory() / GIB)
    security = distributed.Security(**security_of(new_certificates()))
    with kept_environment(), dask.config.set(_settings(sizes.workers)):
        # A process that only counts semaphores would warn of them in two lines when this one ends by a signal. It
        # removes them then all the same.
        os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), _QUIET)))
        with (
            distributed.LocalCluster(
                n_workers=sizes.workers,
                threads_per_worker=1,
                processes=True,
                host=_HOST,
                protocol="tls://",
                security=security,
                dashboard_address=LOOPBACK_PAGE,
                memory_limit=sizes.memory,
                preload=[PINNING, NO_PAGE],
                silence_logs=logging.CRITICAL,
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield client


def cores() -> int:
    """Cores that this process may use."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else CPU_COUNT
    return max(1, min(allowed, CPU_COUNT))


def free_memory() -> int:
    """Memory that can be used without swapping, within the limit of a container [bytes]."""
    return min(psutil.virtual_memory().available, MEMORY_LIMIT)


def _settings(workers: int) -> dict[str, Any]:
    # Libraries read these when they are loaded, which may be before the worker has its cores, so they are there before
    # its process. Products of small matrices are done in the calling thread, as on the command line.
    share = math.ceil(cores() / workers)
    threads = {"OMP_NUM_THREADS": share, "OPENBLAS_NUM_THREADS": 1, "MKL_NUM_THREADS": 1}
    variables = {**threads, WORKERS: workers, **_compiled_code()}
    return {**OURS, "distributed.nanny.pre-spawn-environ": variables}


def _compiled_code() -> dict[str, str]:
    """Workers keep compiled code where this process keeps it, if that was not said by the environment."""
    jax = sys.modules.get("jax")
    folder = jax.config.values["jax_compilation_cache_dir"] if jax is not None else None
    if not folder or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return {}
    return {
        "JAX_COMPILATION_CACHE_DIR": str(folder),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }
