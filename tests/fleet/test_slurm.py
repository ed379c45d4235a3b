"""Jobs of SLURM: what their script says, and a whole cluster whose sbatch starts the script on this machine."""

import os
import signal
import socket
import stat
import sys
import time

import dask
import psutil
import pytest

from jaxscan.errors import DependencyError, OptionError
from jaxscan.fleet import ClusterChoice, open_cluster


pytest.importorskip("dask_jobqueue", reason="the extra `fleet` is not installed")

from jaxscan.fleet.clusters import slurm
from jaxscan.fleet.clusters.settings import OURS
from jaxscan.fleet.clusters.slurm import certificates_for_nodes, slurm_cluster


pytestmark = pytest.mark.rig


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """A home of the test: where certificates lie, and from where no configuration comes."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    with dask.config.set({"jobqueue.slurm.scheduler-options": {"host": "127.0.0.1"}}):
        yield tmp_path / "home"


def script(choice):
    with certificates_for_nodes() as security, slurm_cluster(choice, security) as cluster:
        return cluster.job_script()


def test_a_job_asks_for_what_was_said(home):
    with dask.config.set(
        {"jobqueue.slurm.cores": 6, "jobqueue.slurm.queue": "short", "jobqueue.slurm.walltime": "9:00"}
    ):
        text = script(ClusterChoice(slurm=True, workers=3, memory_gib=7.5))
    lines = text.splitlines()
    assert "#SBATCH --cpus-per-task=6" in lines
    assert "#SBATCH --mem=8G" in lines, "SLURM counts whole ones, rounded up"
    assert "#SBATCH -p short" in lines and "#SBATCH -t 9:00" in lines
    assert "export DASK_DISTRIBUTED__WORKER__MEMORY__SPILL=False" in lines
    command = lines[-1]
    assert command.startswith(f"{sys.executable} -m distributed.cli.dask_worker tls://127.0.0.1:")
    assert "--nthreads 1 --memory-limit 7.50GiB" in command
    assert "--no-dashboard --dashboard-address 127.0.0.1:0 --preload jaxscan.fleet.clusters.no_page" in command
    assert "export DASK_DISTRIBUTED__WORKER__HTTP__ROUTES='[]'" in lines


def test_the_scheduler_here_serves_no_page(home):
    with dask.config.set(OURS), certificates_for_nodes() as security:
        with slurm_cluster(ClusterChoice(slurm=True), security) as cluster:
            where = ("127.0.0.1", cluster.scheduler.http_server.port)
            with pytest.raises(ConnectionRefusedError), socket.create_connection(where, timeout=5.0):
                pass


def test_a_script_holds_paths_and_no_secrets(home):
    with certificates_for_nodes() as security, slurm_cluster(ClusterChoice(slurm=True), security) as cluster:
        text = cluster.job_script()
        key = security.tls_worker_key
        assert f"--tls-key {key}" in text and f"--tls-ca-file {security.tls_ca_file}" in text
        assert "BEGIN" not in text
        with open(key) as file:
            secret = file.read()
        assert not any(line in text for line in secret.splitlines())
        assert stat.S_IMODE(os.stat(key).st_mode) == 0o600
        assert stat.S_IMODE(os.stat(os.path.dirname(key)).st_mode) == 0o700
        assert key.startswith(str(home))
    assert not list(home.glob(".jaxscan*")), "certificates stay behind"


def test_without_configuration_a_job_is_small():
    text = script(ClusterChoice(slurm=True))
    assert "#SBATCH --cpus-per-task=1" in text and "#SBATCH --mem=4G" in text


@pytest.mark.parametrize("unfit", [{"memory": "plenty"}, {"cores": "many"}, {"cores": -2}, {"job-cpu": [3]}])
def test_a_configuration_that_cannot_be_meant_is_one_line(unfit):
    settings = {f"jobqueue.slurm.{name}": value for name, value in unfit.items()}
    with dask.config.set(settings), pytest.raises(OptionError) as caught:
        script(ClusterChoice(slurm=True))
    said = str(caught.value)
    assert repr(next(iter(unfit.values()))) in said and "expected as 8 and 16GiB" in said and "\n" not in said


def test_without_slurm_it_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DependencyError, match="there is no sbatch here"), open_cluster(ClusterChoice(slurm=True)):
        pytest.fail("opened")


def may_spill(dask_worker):
    return dask_worker.memory_manager.memory_spill_fraction


SBATCH = """#!/bin/sh
if [ "$1" = --test-only ]; then {test} fi
cp "$1" {folder}/job-$$.sh
setsid {shell} {folder}/job-$$.sh > {folder}/job-$$.log 2>&1 &
echo $! >> {folder}/jobs
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
kill -- -"$1"
"""
SQUEUE = """#!/bin/sh
for job in $(cat {folder}/jobs); do if kill -0 $job 2> /dev/null; then echo $job; fi; done
"""


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """SLURM's commands are small scripts here, all else is as on a cluster: script, certificates, connections."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    # On a cluster it is installed for all nodes.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    monkeypatch.setattr(slurm, "LOOK_S", 0.2)

    def written(test="exit 0;", shell="sh"):
        for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL), ("squeue", SQUEUE)):
            (folder / name).write_text(text.format(folder=tmp_path, test=test, shell=shell))
            (folder / name).chmod(0o755)

    return written


@pytest.mark.slow
def test_a_whole_cluster_of_jobs(home, programs):
    programs()
    with open_cluster(ClusterChoice(slurm=True, workers=1, memory_gib=0.5)) as client:
        assert client.scheduler.address.startswith("tls://")
        assert client.submit(sum, (2, 3)).result(timeout=30) == 5
        assert list(client.run(may_spill).values()) == [False], "settings did not reach the job"
        (worker,) = client.run(os.getpid).values()
        said = " ".join(psutil.Process(worker).parent().cmdline())
        assert "BEGIN" not in said
    while psutil.pid_exists(worker):  # Ended by the time limit of tests.
        time.sleep(0.05)
    assert not list(home.glob(".jaxscan*")), "certificates stay behind"


@pytest.mark.slow
def test_a_job_that_ended_gets_a_successor(programs, tmp_path):
    programs()
    with open_cluster(ClusterChoice(slurm=True, workers=1, memory_gib=0.5)) as client:
        (first,) = client.run(os.getpid).values()
        (job,) = (tmp_path / "jobs").read_text().split()
        os.killpg(int(job), signal.SIGKILL)
        # A task that is given now waits for the next job.
        assert client.submit(os.getpid, pure=False).result() != first
        assert len((tmp_path / "jobs").read_text().split()) == 2


def test_a_job_that_slurm_refuses_is_one_line(programs):
    programs(test="echo 'sbatch: error: invalid partition specified: long' >&2; exit 1;")
    with pytest.raises(OptionError, match="invalid partition specified: long") as caught:
        with open_cluster(ClusterChoice(slurm=True)):
            pytest.fail("opened")
    assert "\n" not in str(caught.value)


def test_jobs_that_end_at_once_are_one_line_and_not_many(programs, tmp_path, home):
    programs(shell="false")
    with pytest.raises(OptionError, match="3 jobs ended before their worker was there"):
        with open_cluster(ClusterChoice(slurm=True)):
            pytest.fail("opened")
    assert len((tmp_path / "jobs").read_text().split()) <= 4
    assert not list(home.glob(".jaxscan*")), "certificates stay behind"
