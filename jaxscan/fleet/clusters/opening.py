"""One door to all kinds of clusters; what a kind needs is loaded when it is opened."""

import contextlib
import importlib
from collections.abc import Iterator
from typing import Any

from jaxscan.errors import DependencyError
from jaxscan.fleet.clusters.checks import check_versions
from jaxscan.fleet.clusters.choice import ClusterChoice, Kind, check_choice, kind_of


_NEEDED: dict[Kind, tuple[tuple[str, str, str], ...]] = {
    "local": (),
    "running": (),
    "slurm": (("dask_jobqueue", "dask-jobqueue", "fleet"),),
    "kubernetes": (("dask_kubernetes", "dask-kubernetes", "kubernetes"),),
    "ssh": (("asyncssh", "asyncssh", "fleet"),),
}
"""Modules of a kind of cluster, beside Dask: their packages, and the extras that bring them."""


@contextlib.contextmanager
def open_cluster(choice: ClusterChoice) -> Iterator[Any]:
    """A cluster for as long as `with` goes on; what was started for it is ended afterwards.

    Args:
        choice: What the command line says.

    Yields:
        A `distributed.Client` with at least one worker, whose versions were compared with those here.

    Raises:
        OptionError: If the choice contradicts itself, nobody answers, or versions differ.
        DependencyError: If a package or program that this kind of cluster needs is not installed.
    """
    check_choice(choice)
    kind = kind_of(choice)
    _need("distributed", "dask[distributed]", "fleet")
    for module, package, extra in _NEEDED[kind]:
        _need(module, package, extra)
    with _opener(kind)(choice) as client:
        check_versions(client)
        yield client


def _need(module: str, package: str, extra: str) -> None:
    try:
        importlib.import_module(module)
    except ImportError as problem:
        raise DependencyError(f'A cluster needs {package} here: pip install "jaxscan[{extra}]"') from problem


def _opener(kind: Kind) -> Any:
    # Imported here: each loads what only its kind of cluster needs.
    if kind == "local":
        from jaxscan.fleet.clusters.running import open_local

        return open_local
    if kind == "running":
        from jaxscan.fleet.clusters.running import open_running

        return open_running
    if kind == "slurm":
        from jaxscan.fleet.clusters.slurm import open_slurm

        return open_slurm
    if kind == "kubernetes":
        from jaxscan.fleet.clusters.kubernetes import open_kubernetes

        return open_kubernetes
    from jaxscan.fleet.clusters.ssh import open_ssh

    return open_ssh
