"""The cluster of a batch: workers on this machine, or a Dask scheduler that runs already."""

import asyncio
import concurrent.futures
import contextlib
import importlib.metadata
import logging
import math
import os
import platform
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import dask
import distributed
import psutil
from dask.system import CPU_COUNT
from distributed.system import MEMORY_LIMIT
from distributed.versions import VersionMismatchWarning

import jaxscan
from jaxscan.errors import OptionError
from jaxscan.fleet.preload import WORKERS
from jaxscan.project import code_digest


MAX_WORKERS = 10_000
MIN_MEMORY_GIB, MAX_MEMORY_GIB = 0.25, 65536.0
_ADDRESS = re.compile(r"(tcp|tls)://(\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9._-]{1,253}):([0-9]{1,5})")


def check_cluster(address: str | None, workers: int | None, memory_gib: float | None) -> None:
    """Check the options of a cluster; nothing is started or connected.

    Raises:
        OptionError: If they contradict each other, or a value is out of range.
    """
    if address is not None:
        found = _ADDRESS.fullmatch(address)
        if found is None or not 1 <= int(found[3]) <= 65535:
            raise OptionError(f"--cluster: found {address!r:.100}, expected tcp://host:port or tls://host:port.")
        for name, value in (("--workers", workers), ("--memory-gib", memory_gib)):
            if value is not None:
                raise OptionError(f"{name}: does not go with --cluster; a running cluster has its workers.")
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise OptionError(f"--workers: found {workers}, expected 1 ... {MAX_WORKERS}.")
    if memory_gib is not None and not (math.isfinite(memory_gib) and MIN_MEMORY_GIB <= memory_gib <= MAX_MEMORY_GIB):
        raise OptionError(f"--memory-gib: found {memory_gib:g}, expected {MIN_MEMORY_GIB:g} ... {MAX_MEMORY_GIB:g}.")


@contextlib.contextmanager
def open_cluster(
    address: str | None = None, *, workers: int | None = None, memory_gib: float | None = None
) -> Iterator[distributed.Client]:
    """A client of a cluster that has at least one worker, and whose software is that of this process.

    Args:
        address: Of a scheduler, which goes on when `with` ends; None for workers on this machine, which end with it.
        workers: Number of workers on this machine; None for one on each core, fewer if memory is short.
        memory_gib: Memory of each [GiB]; None for equal shares of what is free.

    Raises:
        OptionError: If the options contradict each other, the memory is too little, no scheduler answers, no worker
            is there, or versions differ.
    """
    check_cluster(address, workers, memory_gib)
    with _on_this_machine(workers, memory_gib) if address is None else _connected(address) as client:
        check_versions(client)
        yield client


ANSWER_S = 10.0
"""How long a scheduler may take to answer, and after it the first worker to be there."""


@contextlib.contextmanager
def _connected(address: str) -> Iterator[distributed.Client]:
    """A client of a scheduler that runs; certificates for tls:// are those of Dask's configuration."""
    _ask(address)
    with warnings.catch_warnings():
        # Versions are compared by `check_versions`, with an error of one line.
        warnings.simplefilter("ignore", VersionMismatchWarning)
        client = distributed.Client(address, timeout=ANSWER_S, set_as_default=False)
    with client:
        try:
            client.wait_for_workers(1, timeout=ANSWER_S)
        except TimeoutError as problem:
            start = f"dask worker {address} --nthreads 1 --preload {PRELOAD}"
            raise OptionError(
                f"--cluster: no worker came to {address} within {ANSWER_S:g} s; start some, such as: {start}"
            ) from problem
        yield client


def _ask(address: str) -> None:
    """Ask who listens at an address: a client would wait without end for one that never answers."""

    async def identity() -> Any:
        options = distributed.Security().get_connection_args("client")
        async with distributed.rpc(address, connection_args=options) as there:
            return await there.identity()

    async def within_time() -> Any:
        return await asyncio.wait_for(identity(), ANSWER_S)

    logger = logging.getLogger("distributed")
    level = logger.level
    # Dask logs each attempt that fails; our error reports it once.
    logger.setLevel(logging.CRITICAL)
    try:
        # In a thread of its own, because the thread of a notebook has an event loop already.
        with concurrent.futures.ThreadPoolExecutor(1) as thread:
            found = thread.submit(asyncio.run, within_time()).result()["type"]
    # What is no scheduler may answer anything, and Dask has no one error for that.
    except Exception as problem:
        remedy = (
            "; the certificates are those of Dask's configuration, distributed.comm.tls"
            if address.startswith("tls")
            else ", with no certificate; look at the address"
        )
        raise OptionError(
            f"--cluster: no scheduler of Dask answers at {address} within {ANSWER_S:g} s{remedy}."
        ) from problem
    finally:
        logger.setLevel(level)
    if found != "Scheduler":
        raise OptionError(f"--cluster: found a {found!r:.40} of Dask at {address}, expected its scheduler.")


PRELOAD = "jaxscan.fleet.preload"
_LOOPBACK = "127.0.0.1"
_SETTINGS: Mapping[str, Any] = {
    # Dask can write results to the disk when memory is short, or let a worker wait. Neither helps here: results are
    # names and numbers, what takes the memory is the arrays of a running task, and a worker that waits keeps them. So
    # its nanny ends a worker that comes near its limit and starts another, and the task is tried again.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    # Until the preload closes their HTTP servers, there is nothing to read.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.preload": [PRELOAD],
    # A worker gets one task at a time, so that none waits behind one that is long or that ends its worker.
    "distributed.scheduler.worker-saturation": 1.0,
    # A worker that dies gets a successor, however long that takes to start: Dask would give up after seconds.
    "distributed.deploy.lost-worker-timeout": "1 day",
}


@contextlib.contextmanager
def _on_this_machine(workers: int | None, memory_gib: float | None) -> Iterator[distributed.Client]:
    """Workers on this machine, each with its share of the cores and of the memory."""
    sizes = sizes_for(workers, memory_gib, cores=cores(), free_gib=free_memory() / GIB)
    with _kept_environment(), dask.config.set(_settings(sizes.workers)):
        # The process of Python that counts semaphores would warn of them when this one ends by a signal. It removes
        # them all the same.
        ignored = "ignore:resource_tracker"
        os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), ignored)))
        with (
            distributed.LocalCluster(
                n_workers=sizes.workers,
                threads_per_worker=1,
                processes=True,
                host=_LOOPBACK,
                protocol="tls://",
                # A certificate made for this run, in the memory of these processes alone: everybody with an account
                # on the machine can connect to its loopback, and a cluster executes what it is sent.
                security=True,
                dashboard_address=f"{_LOOPBACK}:0",
                memory_limit=sizes.memory,
                preload=[PRELOAD],
                silence_logs=logging.CRITICAL,
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield client


@contextlib.contextmanager
def _kept_environment() -> Iterator[None]:
    """Restore the environment afterwards: nannies set variables of this process for their workers to inherit."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


def _settings(workers: int) -> dict[str, Any]:
    # Libraries read these when they are loaded, which may be before the worker is pinned to its cores, so they are set
    # before its process starts. Products of small matrices run in the calling thread, as on the command line.
    share = math.ceil(cores() / workers)
    variables = {"OMP_NUM_THREADS": share, "OPENBLAS_NUM_THREADS": 1, "MKL_NUM_THREADS": 1, WORKERS: workers}
    return {**_SETTINGS, "distributed.nanny.pre-spawn-environ": variables | _compilation_cache()}


def _compilation_cache() -> dict[str, str]:
    """Workers keep compiled code where this process keeps it, unless the environment names a folder."""
    jax = sys.modules.get("jax")
    folder = jax.config.values["jax_compilation_cache_dir"] if jax is not None else None
    if not folder or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return {}
    return {
        "JAX_COMPILATION_CACHE_DIR": str(folder),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }


def cores() -> int:
    """Cores that this process may use."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else CPU_COUNT
    return max(1, min(allowed, CPU_COUNT))


def free_memory() -> int:
    """Memory that can be used without swapping, within the limit of a container [bytes]."""
    return min(psutil.virtual_memory().available, MEMORY_LIMIT)


GIB = 1 << 30
LEAST_GIB = 3.0
"""What a worker should have: a sweep, its compiled code and its products."""
_RESERVE_GIB, _RESERVE_SHARE = 1.0, 0.1
"""What stays free for the caller, the scheduler and the system's cache of files: the larger of both."""


class WorkerSizes(NamedTuple):
    """Workers of one machine, and the memory of each [bytes]."""

    workers: int
    memory: int


def sizes_for(workers: int | None, memory_gib: float | None, *, cores: int, free_gib: float) -> WorkerSizes:
    """Share out the free memory of a machine.

    Args:
        workers: The wanted number; None for one on each core, fewer if memory is short.
        memory_gib: Memory of each [GiB]; None for equal shares of what is free.
        cores: Cores that may be used.
        free_gib: Memory that is free now [GiB].

    Raises:
        OptionError: If the wanted workers do not fit.
    """
    room = free_gib - max(_RESERVE_GIB, _RESERVE_SHARE * free_gib)
    least = LEAST_GIB if memory_gib is None else memory_gib
    fitting = int(max(room, 0.0) / least)
    free = f"{max(room, 0.0):.1f} GiB of memory are free for workers"
    if workers is None:
        if memory_gib is not None and fitting < 1:
            raise OptionError(f"--memory-gib {memory_gib:g}: {free}; expected less.")
        workers = max(1, min(cores, fitting))
    elif workers > fitting and (workers > 1 or memory_gib is not None):
        most = max(1, fitting) if memory_gib is None else fitting
        remedy = f"take --workers {most}, or set --memory-gib" if most else "set --memory-gib to less"
        raise OptionError(f"--workers {workers}: {free}, and {least:g} GiB are needed for each; {remedy}.")
    if memory_gib is None and room < _RESERVE_GIB:
        raise OptionError(f"this machine: {free}, too little for a worker; end other programs, or set --memory-gib.")
    each_gib = room / workers if memory_gib is None else memory_gib
    return WorkerSizes(workers, int(each_gib * GIB))


Versions = dict[str, str]
"""Versions by the name of the software."""
_REFUSED = ("jaxscan", "Python", "dask", "distributed")
_WARNED = ("jax", "jaxlib", "numpy")
_PACKAGES = ("dask", "distributed", *_WARNED)


def versions_here() -> Versions:
    """The software of this process; workers run this function too."""
    digest = code_digest().removeprefix("sha256:")[:12]
    found = {
        "jaxscan": f"{jaxscan.__version__} (code {digest})",
        "Python": ".".join(platform.python_version_tuple()[:2]),
    }
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "none"
    return found


def check_versions(client: distributed.Client) -> None:
    """Compare the software here with that of the scheduler and of every worker.

    Another JAX or NumPy computes the same to rounding, which is a warning.

    Raises:
        OptionError: If jaxscan, Python or Dask are of other versions there, or a worker has no jaxscan.
    """
    here = versions_here()
    reported: Any = client.get_versions(packages=list(_PACKAGES))
    # What Dask itself reports comes first: with another Python or Dask, a function may not arrive there.
    for place, found in (("the scheduler", reported["scheduler"]), *sorted(reported["workers"].items())):
        _compare(here, _from_dask(found), place)
    # The scheduler needs no jaxscan: it passes names and numbers on.
    for place, answer in sorted(client.run(versions_here, on_error="return").items()):
        if isinstance(answer, OSError):
            continue  # It ended meanwhile; its successor is started from the same files.
        if isinstance(answer, BaseException):
            raise OptionError(
                f"the cluster's worker {place} has no jaxscan that knows batches ({type(answer).__name__}); "
                f"install {here['jaxscan']} there."
            )
        _compare(here, answer, place)


def _from_dask(found: dict[str, Any] | None) -> Versions:
    packages = (found or {}).get("packages", {})
    versions = {name: str(packages[name]) for name in _PACKAGES if packages.get(name)}
    if packages.get("python"):
        versions["Python"] = ".".join(str(packages["python"]).split(".")[:2])
    return versions


def _compare(here: Versions, there: Versions, place: str) -> None:
    """Compare what both sides have: a scheduler needs no JAX."""
    differing = [name for name in here if name in there and there[name] != here[name]]
    who = "the cluster's scheduler" if place == "the scheduler" else f"the cluster's worker {place}"
    for name in _REFUSED:
        if name in differing:
            raise OptionError(f"{who} runs {name} {there[name]}, and here is {here[name]}; install the same on both.")
    for name in _WARNED if place != "the scheduler" else ():
        if name in differing:
            warnings.warn(
                f"{who} computes with {name} {there[name]}, and here is {here[name]}: results may differ by rounding.",
                RuntimeWarning,
                stacklevel=3,
            )
