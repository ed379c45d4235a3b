"""Clusters of Dask that run already, and those that are started on this machine."""

import asyncio
import contextlib
import logging
import math
import os
import ssl
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import distributed
import psutil
from dask.system import CPU_COUNT
from distributed.system import MEMORY_LIMIT
from distributed.versions import VersionMismatchWarning

from jaxscan.errors import OptionError
from jaxscan.files.disk import MEGABYTE, read_bounded
from jaxscan.fleet.clusters.certificates import new_certificates, paths_in, security_of
from jaxscan.fleet.clusters.checks import GIB, sizes_for
from jaxscan.fleet.clusters.choice import ClusterChoice
from jaxscan.fleet.clusters.pinning import WORKERS
from jaxscan.fleet.clusters.settings import (
    LOOPBACK_PAGE,
    NO_PAGE,
    OURS,
    PINNING,
    kept_environment,
    run_apart,
    wait_for_worker,
)


ANSWER_S = 10.0
"""How long a scheduler may take to answer, and after it the first worker to be there."""


@contextlib.contextmanager
def open_running(choice: ClusterChoice) -> Iterator[Any]:
    """A client of a running cluster; the cluster stays when `with` ends.

    Raises:
        OptionError: If the files of certificates are unfit, nobody answers, or there is no worker.
    """
    security = security_from(choice.tls) if choice.tls is not None else None
    with connected(str(choice.address), security) as client:
        start = f"dask worker {choice.address} --nthreads 1 --preload {PINNING}"
        wait_for_worker(client, ANSWER_S, f"start workers for {choice.address}, such as: {start}")
        yield client


def security_from(folder: Path) -> Any:
    """Dask's `Security` from a folder with ca.pem, cert.pem and key.pem.

    Raises:
        OptionError: If one of them is missing or no PEM file of its kind.
    """
    paths = paths_in(folder)
    for path in paths:
        read_bounded(path, MEGABYTE, error=OptionError)
    security = distributed.Security(**security_of(paths))
    try:
        security.get_connection_args("client")
    except (ssl.SSLError, OSError) as problem:
        raise OptionError(f"--tls {folder}: holds no certificates that belong together: {problem}.") from problem
    return security


@contextlib.contextmanager
def connected(address: str, security: Any = None) -> Iterator[Any]:
    """A client of a scheduler.

    Raises:
        OptionError: If it does not answer in `ANSWER_S`, or refuses.
    """
    _ask(address, security or distributed.Security())
    with warnings.catch_warnings():
        # Versions are compared by `check_versions`, with a line of its own.
        warnings.simplefilter("ignore", VersionMismatchWarning)
        client = distributed.Client(address, security=security, timeout=ANSWER_S, set_as_default=False)
    with client:
        yield client


def _ask(address: str, security: Any) -> None:
    """Ask who is there, because a client would wait for ever for the words of one who says none."""

    async def identity() -> Any:
        async with distributed.rpc(address, connection_args=security.get_connection_args("client")) as there:
            return await there.identity()

    async def within_time() -> Any:
        return await asyncio.wait_for(identity(), ANSWER_S)

    try:
        with _quiet():
            found = run_apart(within_time())["type"]
    # What is no scheduler may answer anything, and Dask has no one error for that.
    except Exception as problem:
        raise OptionError(
            f"--cluster: no scheduler of Dask answers at {address} within {ANSWER_S:g} s, or it does not know this "
            "certificate; look at its address and --tls."
        ) from problem
    if found != "Scheduler":
        raise OptionError(
            f"--cluster: found a {found!r:.40} of Dask at {address}, expected the address of its scheduler."
        )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without Dask's own lines about attempts that failed; ours says it."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


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
