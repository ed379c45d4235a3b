"""Workers as jobs of SLURM, by dask-jobqueue. What a job asks for is in Dask's own configuration, jobqueue.yaml."""

import contextlib
import os
import shlex
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import distributed
from dask.utils import parse_bytes

from jaxscan.errors import DependencyError, OptionError, OutputError
from jaxscan.files.disk import reported
from jaxscan.fleet.clusters.certificates import make_certificates, security_of
from jaxscan.fleet.clusters.choice import ClusterChoice, patience_of
from jaxscan.fleet.clusters.jobs import MOST_IN_VAIN, Jobs, jobs_of
from jaxscan.fleet.clusters.settings import LOOPBACK_PAGE, MEMORY, NO_PAGE, OURS, PAGELESS, as_environment


_CORES, _MEMORY = 1, "4GiB"
"""What a job asks for where the configuration says nothing."""
_MAX_CORES = 4096


@contextlib.contextmanager
def open_slurm(choice: ClusterChoice) -> Iterator[Any]:
    """The scheduler in this process, and one job of SLURM for each worker.

    A job that ends gets a successor. All are cancelled when `with` ends.

    A network of such a cluster has other users, so all connections are encrypted and ask for a certificate. It lies in
    a private folder that the nodes can read too; the scripts of the jobs hold its path.

    Raises:
        DependencyError: If there is no SLURM here.
        OptionError: If SLURM takes no such job, none starts in a day, or jobs end before their worker is there.
        OutputError: If the folder for certificates cannot be made.
    """
    if shutil.which("sbatch") is None:
        raise DependencyError("--slurm: there is no sbatch here; call it on a machine from which SLURM takes jobs.")
    with (
        dask.config.set(OURS),
        certificates_for_nodes() as security,
        slurm_cluster(choice, security) as cluster,
    ):
        with jobs_of(cluster, choice.workers or 1) as jobs, distributed.Client(cluster, set_as_default=False) as client:
            _wait(client, jobs, patience_of(choice))
            yield client


def _wait(client: Any, jobs: Jobs, seconds: float) -> None:
    """Wait for the first worker, as long as jobs wait or run."""
    until = time.monotonic() + seconds
    while jobs.in_vain < MOST_IN_VAIN and time.monotonic() < until:
        with contextlib.suppress(TimeoutError):
            client.wait_for_workers(1, timeout=1)
            return
    if jobs.in_vain < MOST_IN_VAIN:
        raise OptionError(f"--slurm: no job began within {seconds / 3600:.0f} h; look at squeue.")
    raise OptionError(
        f"--slurm: {jobs.in_vain} jobs ended before their worker was there; look at their logs, slurm-NUMBER.out."
    )


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
    exports = [f"export {name}={shlex.quote(value)}" for name, value in as_environment({**MEMORY, **PAGELESS}).items()]
    no_page = ["--no-dashboard", "--dashboard-address", LOOPBACK_PAGE, "--preload", NO_PAGE]
    scheduler = {"dashboard": False, "dashboard_address": LOOPBACK_PAGE, **configured("scheduler-options", {})}
    return SLURMCluster(
        # One task at a time on all cores of a job.
        cores=1,
        processes=1,
        job_cpu=int(cores),
        memory=memory,
        job_script_prologue=[*configured("job-script-prologue", []), *exports],
        worker_extra_args=[*configured("worker-extra-args", []), *no_page],
        security=security,
        protocol="tls://",
        scheduler_options=scheduler,
    )
