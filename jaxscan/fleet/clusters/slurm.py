"""Workers as jobs of SLURM, by dask-jobqueue. What a job asks for is in Dask's own configuration, jobqueue.yaml."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import distributed
from dask.utils import parse_bytes

from jaxscan.errors import DependencyError, OptionError, OutputError
from jaxscan.files.disk import reported
from jaxscan.fleet.clusters.certificates import make_certificates, security_of
from jaxscan.fleet.clusters.choice import ClusterChoice
from jaxscan.fleet.clusters.settings import LOOPBACK_PAGE, MEMORY, as_environment, wait_for_worker


WAIT_S = 24 * 3600.0
"""How long the first job may wait in the queue."""
_CORES, _MEMORY = 1, "4GiB"
"""What a job asks for where the configuration says nothing."""
_MAX_CORES = 4096


@contextlib.contextmanager
def open_slurm(choice: ClusterChoice) -> Iterator[Any]:
    """The scheduler in this process, and one job of SLURM for each worker; they are cancelled when `with` ends.

    A network of such a cluster has other users, so all connections are encrypted and ask for a certificate. It lies in
    a private folder that the nodes can read too; the scripts of the jobs hold its path.

    Raises:
        DependencyError: If there is no SLURM here.
        OptionError: If no job starts in a day.
        OutputError: If the folder for certificates cannot be made.
    """
    if shutil.which("sbatch") is None:
        raise DependencyError("--slurm: there is no sbatch here; call it on a machine from which SLURM takes jobs.")
    with certificates_for_nodes() as security, slurm_cluster(choice, security) as cluster:
        cluster.scale(jobs=choice.workers or 1)
        with distributed.Client(cluster, set_as_default=False) as client:
            wait_for_worker(client, WAIT_S, "look at squeue, and at the log of a job.")
            yield client


@contextlib.contextmanager
def certificates_for_nodes() -> Iterator[Any]:
    """Dask's `Security` with certificates in a folder that is removed afterwards.

    It is made in `jobqueue.slurm.shared-temp-directory`, else at home: what all nodes of a cluster see.
    """
    shared = dask.config.get("jobqueue.slurm.shared-temp-directory", None) or Path.home()
    folder = None
    with reported(f"{shared}: certificates for the jobs cannot be kept there", error=OutputError):
        folder = tempfile.mkdtemp(prefix=".jaxscan-", dir=os.path.expanduser(shared))
    try:
        yield distributed.Security(**security_of(make_certificates(os.path.join(folder, "tls"))))
    finally:
        shutil.rmtree(folder)


def slurm_cluster(choice: ClusterChoice, security: Any) -> Any:
    """The cluster without a job.

    Raises:
        OptionError: If Dask's configuration of a job's cores or memory cannot be meant.
    """
    # Registers its part of Dask's configuration.
    from dask_jobqueue import SLURMCluster

    def configured(name: str, otherwise: Any = None) -> Any:
        return dask.config.get(f"jobqueue.slurm.{name}", None) or otherwise

    memory = f"{choice.memory_gib}GiB" if choice.memory_gib is not None else configured("memory", _MEMORY)
    cores = configured("job-cpu") or configured("cores", _CORES)
    try:
        parse_bytes(memory)
        if not 1 <= int(cores) <= _MAX_CORES:
            raise ValueError(f"cores: {cores}")
    except (ValueError, TypeError) as problem:
        said = f"cores {cores!r:.40} and memory {memory!r:.40}"
        raise OptionError(f"--slurm: Dask's configuration has {said}, expected as 8 and 16GiB.") from problem
    exports = [f"export {name}={value}" for name, value in as_environment(MEMORY).items()]
    return SLURMCluster(
        # One task at a time on all cores of a job.
        cores=1,
        processes=1,
        job_cpu=int(cores),
        memory=memory,
        job_script_prologue=[*configured("job-script-prologue", []), *exports],
        worker_extra_args=[*configured("worker-extra-args", []), "--dashboard-address", LOOPBACK_PAGE],
        security=security,
        protocol="tls://",
        scheduler_options={"dashboard_address": LOOPBACK_PAGE, **configured("scheduler-options", {})},
    )
