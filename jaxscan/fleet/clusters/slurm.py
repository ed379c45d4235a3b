"""Workers as jobs of SLURM: jobs that end while a batch goes on get successors."""

import contextlib
import getpass
import os
import shlex
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from typing import Any, final

import dask
import distributed
from dask.utils import parse_bytes

from jaxscan.errors import DependencyError, OptionError, OutputError
from jaxscan.files.disk import reported
from jaxscan.fleet.clusters.certificates import make_certificates, security_of
from jaxscan.fleet.clusters.choice import ClusterChoice, patience_of
from jaxscan.fleet.clusters.settings import LOOPBACK_PAGE, MEMORY, NO_PAGE, OURS, PAGELESS, as_environment


LOOK_S = 20.0
"""Between two looks at the queue; SLURM answers one question for all jobs."""
SELDOM_S = 600.0
"""The same, while jobs end before their worker is there."""
MOST_IN_VAIN = 3
"""So many of these jobs mean that the next one would not be better."""
_ANSWER_S = 30.0


@final
class Jobs:
    """The jobs of a cluster of dask-jobqueue."""

    def __init__(self, cluster: Any, number: int) -> None:
        """Args: the cluster, and how many jobs it is to have."""
        self._cluster, self._number = cluster, number
        self._looked = 0.0
        self._came = set[str]()
        self.in_vain = 0
        """Jobs that ended before their worker was there, since the last one that came."""

    def look(self) -> None:
        """Start a successor of each job that is not in the queue any more."""
        now = time.monotonic()
        # Before the queue is asked: a job that is submitted in between would seem to have ended.
        jobs = {name: str(job.job_id) for name, job in dict(self._cluster.workers).items()}
        queued = queued_jobs()
        if queued is None or (self.in_vain >= MOST_IN_VAIN and now - self._looked < SELDOM_S):
            return
        self._looked = now
        self._cluster.sync(self._replace, queued, jobs)

    async def _replace(self, queued: Set[str], known: Mapping[str, str]) -> None:
        there = {worker["name"] for worker in self._cluster.scheduler_info["workers"].values()}
        jobs = {name: number for name, number in known.items() if name in self._cluster.workers}
        self._came |= {jobs[name] for name in there & jobs.keys()}
        ended = [name for name in jobs if name not in there and jobs[name] not in queued]
        for name in ended:
            # What the cluster has no job for, it starts.
            del self._cluster.workers[name]
        self.in_vain = 0 if there else self.in_vain + sum(jobs[name] not in self._came for name in ended)
        if len(self._cluster.workers) < self._number:
            # A job that SLURM refuses now is tried again at the next look.
            with contextlib.suppress(RuntimeError):
                await self._cluster


@contextlib.contextmanager
def jobs_of(cluster: Any, number: int) -> Iterator[Jobs]:
    """Start jobs, and look after them until the end of `with`.

    Raises:
        OptionError: If SLURM takes no such job.
    """
    _check(cluster)
    cluster.scale(jobs=number)
    jobs, ended = Jobs(cluster, number), threading.Event()

    def look_after() -> None:
        while not ended.wait(LOOK_S):
            jobs.look()

    thread = threading.Thread(target=look_after, name="jobs of SLURM", daemon=True)
    thread.start()
    try:
        yield jobs
    finally:
        ended.set()
        thread.join()


def _check(cluster: Any) -> None:
    """Ask SLURM whether it would take the cluster's jobs; none is started."""
    script = cluster.job_script().encode()
    try:
        asked = subprocess.run(
            ["sbatch", "--test-only"], input=script, capture_output=True, timeout=_ANSWER_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as problem:
        raise OptionError(f"--slurm: sbatch does not answer: {problem}.") from problem
    if asked.returncode != 0:
        said = " ".join(asked.stderr.decode(errors="replace").split()) or f"exit code {asked.returncode}"
        raise OptionError(f"--slurm: SLURM takes no such job ({said:.300}); look at ~/.config/dask/jobqueue.yaml.")


def queued_jobs() -> frozenset[str] | None:
    """The jobs of this user that wait or run, by their numbers; None if SLURM does not answer now."""
    command = ["squeue", "--noheader", "--user", getpass.getuser(), "--format", "%A"]
    try:
        asked = subprocess.run(command, capture_output=True, timeout=_ANSWER_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return frozenset(asked.stdout.decode().split()) if asked.returncode == 0 else None


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
