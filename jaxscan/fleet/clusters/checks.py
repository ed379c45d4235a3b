"""Whether workers fit: the versions of their software, their cores and their memory."""

import functools
import hashlib
import importlib.metadata
import platform
import warnings
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jaxscan
from jaxscan.errors import JaxscanError, OptionError
from jaxscan.files.disk import MEGABYTE, read_bounded


Versions = dict[str, str]
"""Versions by the name of the software."""

_REFUSED = ("jaxscan", "Python", "dask", "distributed")
_SAID = ("jax", "jaxlib", "numpy")
_PACKAGES = ("dask", "distributed", "jax", "jaxlib", "numpy")


@functools.lru_cache(maxsize=1)
def package_digest() -> str:
    """Digest of all Python files of the package, so that two states of one version are told apart."""
    return digest_below(Path(str(resources.files("jaxscan"))))


def digest_below(folder: Path) -> str:
    """Digest of the Python files below a folder and of their names, as "sha256:<hex>"."""
    digest = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        content = read_bounded(file, MEGABYTE, error=JaxscanError)
        digest.update(f"{file.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return "sha256:" + digest.hexdigest()


def versions_here() -> Versions:
    """What this process runs on; workers are asked for it too. JAX is not loaded."""
    digest = package_digest().removeprefix("sha256:")[:12]
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


def check_versions(client: Any) -> None:
    """Compare the software here with that of the scheduler and of every worker.

    Another JAX or NumPy computes the same to rounding, which is a warning.

    Args:
        client: A `distributed.Client`.

    Raises:
        OptionError: If jaxscan, Python or Dask are of other versions there, or a worker has no jaxscan.
    """
    here = versions_here()
    asked = client.get_versions(packages=list(_PACKAGES))
    # By Dask's own words first: with another Python or Dask nothing else may be understood.
    for place, found in (("the scheduler", asked["scheduler"]), *sorted(asked["workers"].items())):
        _compare(here, _from_dask(found), place)
    # The scheduler needs no jaxscan: it hands names and numbers on.
    for place, answer in sorted(client.run(versions_here, on_error="return").items()):
        if isinstance(answer, OSError):
            continue  # It ended while it was asked; its successor is started from the same files.
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
    """One side may not know of a package: a scheduler needs no JAX."""
    differing = [name for name in here if name in there and there[name] != here[name]]
    who = "the cluster's scheduler" if place == "the scheduler" else f"the cluster's worker {place}"
    for name in _REFUSED:
        if name in differing:
            raise OptionError(f"{who} runs {name} {there[name]}, and here is {here[name]}; install the same on both.")
    if place == "the scheduler":
        return
    for name in _SAID:
        if name in differing:
            said = (
                f"{who} computes with {name} {there[name]}, and here is {here[name]}: results may differ by rounding."
            )
            warnings.warn(said, RuntimeWarning, stacklevel=3)


LEAST_GIB = 3.0
"""What a worker should have: a sweep, its compiled code and its products."""
_RESERVE_GIB, _RESERVE_SHARE = 1.0, 0.1
"""What stays free for the caller, the scheduler and the system's cache of files: the larger of both."""
GIB = 1 << 30


class WorkerSizes(NamedTuple):
    """Workers of one machine, and the memory of each [bytes]."""

    workers: int
    memory: int


def sizes_for(workers: int | None, memory_gib: float | None, *, cores: int, free_gib: float) -> WorkerSizes:
    """Share out the free memory of a machine.

    Args:
        workers: As many as are asked for; None for one on each core, fewer if memory is short.
        memory_gib: Memory of each [GiB]; None for equal shares of what is free.
        cores: Cores that may be used.
        free_gib: Memory that is free now [GiB].

    Raises:
        OptionError: If what is asked for does not fit.
    """
    room = free_gib - max(_RESERVE_GIB, _RESERVE_SHARE * free_gib)
    least = LEAST_GIB if memory_gib is None else memory_gib
    fitting = int(max(room, 0.0) / least)
    if workers is None:
        if memory_gib is not None and fitting < 1:
            raise OptionError(f"--memory-gib {memory_gib:g}: {_free(room)}; expected less.")
        workers = max(1, min(cores, fitting))
    elif workers > fitting and (workers > 1 or memory_gib is not None):
        most = max(1, fitting) if memory_gib is None else fitting
        remedy = f"take --workers {most}, or set --memory-gib" if most else "set --memory-gib to less"
        raise OptionError(f"--workers {workers}: {_free(room)}, and {least:g} GiB are needed for each; {remedy}.")
    if memory_gib is None and room < _RESERVE_GIB:
        raise OptionError(
            f"this machine: {_free(room)}, too little for a worker; end other programs, or set --memory-gib."
        )
    each_gib = room / workers if memory_gib is None else memory_gib
    return WorkerSizes(workers, int(each_gib * GIB))


def _free(room: float) -> str:
    return f"{max(room, 0.0):.1f} GiB of memory are free for workers"
