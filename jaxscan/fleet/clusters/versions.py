"""Compares the software of a cluster with that of the caller: products of two versions must not be mixed."""

import functools
import hashlib
import importlib.metadata
import platform
import warnings
from importlib import resources
from pathlib import Path
from typing import Any

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
