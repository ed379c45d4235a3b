"""Jobs of SLURM while a batch goes on: those that ended, by their time or a broken node, get successors."""

import contextlib
import getpass
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Set
from typing import Any, final

from jaxscan.errors import OptionError


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
