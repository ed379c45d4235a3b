"""The cluster of a batch: options, workers on this machine, a scheduler that runs, and the versions of both sides."""

import contextlib
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import dask
import distributed
import jax
import psutil
import pytest

import jaxscan
from jaxscan import __version__
from jaxscan.errors import OptionError
from jaxscan.fleet import cluster as module
from jaxscan.fleet.cluster import (
    GIB,
    WorkerSizes,
    check_cluster,
    check_versions,
    cores,
    open_cluster,
    sizes_for,
    versions_here,
)
from jaxscan.fleet.preload import share_of
from jaxscan.project import code_digest, steps


REFUSED = {
    "no scheme": (("a:1", None, None), "expected tcp://host:port"),
    "no port": (("tcp://a", None, None), "expected tcp://host:port"),
    "a high port": (("tcp://a:65536", None, None), "expected tcp://host:port"),
    "lines": (("tcp://a:1\nb", None, None), "expected tcp://host:port"),
    "in this process": (("inproc://a:1", None, None), "expected tcp://host:port"),
    "no workers": ((None, 0, None), "--workers: found 0, expected 1"),
    "too many": ((None, 10**9, None), "--workers: found 1000000000"),
    "no number": ((None, None, float("nan")), "--memory-gib: found nan"),
    "no memory": ((None, None, -1.0), "--memory-gib: found -1"),
    "workers of others": (("tcp://a:1", 2, None), "--workers: does not go with --cluster"),
    "memory of others": (("tcp://a:1", None, 2.0), "--memory-gib: does not go with"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_options_that_contradict_each_other_are_one_line(name):
    options, says = REFUSED[name]
    with pytest.raises(OptionError) as caught:
        check_cluster(*options)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_of_a_cluster():
    check_cluster(None, None, None)
    check_cluster(None, 2, 4.0)
    check_cluster("tcp://10.0.0.5:8786", None, None)
    check_cluster("tls://[fe80::1]:8786", None, None)


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
def test_shares_are_disjoint_and_whole(workers):
    mine = {0, 2, 3, 7, 9, 10}
    shares = [share_of(k, workers, mine) for k in range(workers)]
    assert set.union(*shares) == mine
    assert sum(len(share) for share in shares) == len(mine)
    assert shares[0] == set(sorted(mine)[::workers])


def test_more_workers_than_cores_share_one():
    assert [share_of(k, 5, {4, 6}) for k in range(5)] == [{4}, {6}, {4}, {6}, {4}]


@pytest.mark.parametrize(
    ("asked", "free", "expected"),
    [
        ((None, None), 20.0, (4, 4.5)),  # 18 GiB for workers: one on each core.
        ((None, None), 11.0, (3, 9.9 / 3)),  # Short: three have at least 3 GiB.
        ((None, None), 3.0, (1, 2.0)),  # Never none.
        ((2, None), 20.0, (2, 9.0)),
        ((None, 1.0), 5.0, (4, 1.0)),
        ((None, 3.5), 20.0, (4, 3.5)),
        ((6, 2.0), 20.0, (6, 2.0)),  # More than cores, if that is asked for.
        ((1, None), 3.0, (1, 2.0)),
    ],
)
def test_memory_is_shared_out(asked, free, expected):
    assert sizes_for(*asked, cores=4, free_gib=free) == WorkerSizes(expected[0], int(expected[1] * GIB))


@pytest.mark.parametrize(
    ("asked", "free", "says"),
    [
        ((4, None), 11.0, r"--workers 4: 9\.9 GiB .* 3 GiB are needed for each; take --workers 3, or"),
        ((2, None), 3.0, r"--workers 2: 2\.0 GiB .* take --workers 1, or"),
        ((4, 3.0), 11.0, r"take --workers 3, or set"),
        ((2, 30.0), 11.0, r"--workers 2: .* set --memory-gib to less"),
        ((None, 30.0), 11.0, r"--memory-gib 30: 9\.9 GiB .* expected less"),
        ((None, None), 1.5, r"this machine: 0\.5 GiB"),
    ],
)
def test_what_does_not_fit_is_one_line(asked, free, says):
    with pytest.raises(OptionError, match=says) as caught:
        sizes_for(*asked, cores=4, free_gib=free)
    assert "\n" not in str(caught.value)


# Workers on this machine.


def report_of(dask_worker):
    """Of a worker that has computed something: its process, the cores of all threads, and its environment."""
    jax.numpy.ones(8).sum().block_until_ready()
    threads = {frozenset(os.sched_getaffinity(int(thread))) for thread in os.listdir("/proc/self/task")}
    limit = dask_worker.memory_manager.memory_limit
    inherited = os.environ["JAXSCAN_TEST_WORD"], jax.config.jax_compilation_cache_dir
    return os.getpid(), threads, inherited, limit, os.environ["OMP_NUM_THREADS"]


def addresses(client):
    return {worker["name"]: place for place, worker in client.scheduler_info(-1)["workers"].items()}


def reports(client):
    found = client.run(report_of)
    return {name: found[place] for name, place in addresses(client).items()}


@pytest.fixture(scope="module")
def client():
    """Of two workers on this machine."""
    before = dict(os.environ)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAXSCAN_TEST_WORD", "from the caller")
        with open_cluster(workers=2, memory_gib=0.5) as client:
            yield client
            workers = [report[0] for report in reports(client).values()]
    assert not any(psutil.pid_exists(worker) for worker in workers)
    assert dict(os.environ) == before


@pytest.mark.rig
def test_a_worker_has_its_share_of_cores_memory_and_environment(client):
    found = reports(client)
    mine = os.sched_getaffinity(0)
    assert set(found) == {0, 1}
    cache = os.environ.get("JAX_COMPILATION_CACHE_DIR") or jax.config.jax_compilation_cache_dir
    assert cache
    for name, (_, threads, inherited, limit, share) in found.items():
        assert threads == {frozenset(share_of(name, 2, mine))}
        assert inherited == ("from the caller", cache)
        assert limit == GIB // 2
        assert int(share) == -(-cores() // 2)


@pytest.mark.rig
def test_ctrl_c_at_the_terminal_is_for_the_caller_alone(client):
    before = reports(client)
    for report in before.values():
        os.kill(report[0], signal.SIGINT)
    assert reports(client) == before


def hold(memory):
    """A task that takes more memory than its worker may have."""
    held = bytearray(b"1") * memory
    time.sleep(60)
    return len(held)


@pytest.mark.rig
@pytest.mark.slow
def test_a_worker_over_its_limit_is_replaced_and_nothing_goes_to_the_disk(client):
    before, place = reports(client), addresses(client)[1]
    # At that address only: the successor, which has another, does not try it again.
    task = client.submit(hold, GIB, workers=[place], allow_other_workers=False)
    while addresses(client).get(1, place) == place:  # Ended by the time limit of tests.
        time.sleep(0.1)
    task.release()
    after = reports(client)
    assert after[1][0] != before[1][0] and after[1][1:] == before[1][1:]
    assert after[0] == before[0]
    assert not any(client.run(spills).values())


def spills(dask_worker):
    manager = dask_worker.memory_manager
    return manager.memory_target_fraction or manager.memory_spill_fraction or manager.memory_pause_fraction


@pytest.mark.rig
def test_the_successor_of_a_killed_worker_has_its_cores_too(client):
    before, place = reports(client), addresses(client)[0]
    os.kill(before[0][0], signal.SIGKILL)
    while addresses(client).get(0, place) == place:  # Ended by the time limit of tests.
        time.sleep(0.1)
    after = reports(client)
    assert after[0][0] != before[0][0]
    assert after[0][1] == before[0][1]
    assert after[1] == before[1]


@pytest.mark.rig
def test_all_listens_on_the_loopback(client):
    processes = [psutil.Process(), *(psutil.Process(report[0]) for report in reports(client).values())]
    places = [c.laddr.ip for p in processes for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
    assert len(places) >= 3, "scheduler and two workers"
    assert set(places) == {"127.0.0.1"}


@pytest.mark.rig
def test_nobody_serves_a_page(client):
    """Dask's HTTP knows no password, and without its dashboard too it shows what all do."""
    found = client.run(lambda dask_worker: (os.getpid(), dask_worker.http_server.port))
    pages = {os.getpid(): client.cluster.scheduler.http_server.port, **dict(found.values())}
    assert len(pages) == 3
    for pid, port in pages.items():
        listening = psutil.Process(pid).net_connections()
        assert port not in {c.laddr.port for c in listening if c.status == psutil.CONN_LISTEN}
        with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port), timeout=5.0):
            pass


@pytest.mark.rig
def test_another_user_of_the_machine_is_not_heard(client, soon):
    address = client.scheduler.address
    with pytest.raises(OptionError, match="no scheduler of Dask answers"):
        with open_cluster(address.replace("tls://", "tcp://")):
            pytest.fail("connected")
    # One who knows the certificate as an authority, but has none to show.
    host, port = address.removeprefix("tls://").split(":")
    context = ssl.create_default_context(cadata=client.cluster.security.tls_ca_file)
    context.check_hostname = False
    with socket.create_connection((host, int(port)), timeout=10) as plain, context.wrap_socket(plain) as encrypted:
        with pytest.raises(OSError, match=r"(?i)certificate required|reset|closed|eof"):
            encrypted.sendall(b"\0" * 64)
            if not encrypted.recv(64):
                raise OSError("closed")


# A scheduler that runs.


@pytest.fixture
def soon(monkeypatch):
    """What does not answer is given up after a second."""
    monkeypatch.setattr(module, "ANSWER_S", 1.0)


@contextlib.contextmanager
def cluster(security=None, workers=1):
    """A scheduler and workers in threads of this process, as somebody else may have started them."""
    with distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=False,
        host="127.0.0.1",
        protocol="tls://" if security else "tcp://",
        security=security,
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
    ) as cluster:
        yield cluster


def configured(security, folder):
    """Dask's configuration with certificates in a folder."""
    folder.mkdir()
    names = {"ca-file": "tls_ca_file", "client.cert": "tls_client_cert", "client.key": "tls_client_key"}
    for name, field in names.items():
        (folder / name).write_text(getattr(security, field))
    return {f"distributed.comm.tls.{name}": str(folder / name) for name in names}


@pytest.mark.rig
def test_who_holds_the_certificate_may_connect(monkeypatch, tmp_path):
    security = distributed.Security.temporary()
    with cluster(security) as running, dask.config.set(configured(security, tmp_path / "mine")):
        with open_cluster(running.scheduler_address) as client:
            assert client.submit(sum, (2, 3)).result(timeout=20) == 5
        # It goes on when the client has gone.
        with open_cluster(running.scheduler_address) as client:
            assert len(client.scheduler_info()["workers"]) == 1
        monkeypatch.setattr(module, "ANSWER_S", 1.0)
        other = configured(distributed.Security.temporary(), tmp_path / "other")
        unfit = dict.fromkeys(other, os.devnull)
        for settings in (other, unfit, dict.fromkeys(other)):
            with dask.config.set(settings), pytest.raises(OptionError, match=r"distributed\.comm\.tls") as caught:
                with open_cluster(running.scheduler_address):
                    pytest.fail("connected")
            assert "\n" not in str(caught.value)


@pytest.mark.rig
def test_where_nobody_listens_is_one_line(soon):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        with pytest.raises(OptionError, match="no scheduler of Dask answers") as caught:
            with open_cluster(f"tcp://127.0.0.1:{free.getsockname()[1]}"):
                pytest.fail("connected")
    assert "\n" not in str(caught.value)


@pytest.mark.rig
@pytest.mark.parametrize("answer", [None, b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\xff" * 4096, b"\0" * 4096])
def test_what_is_no_scheduler_is_one_line(answer, soon):
    def serve(listening):
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            kept.append(connection)
            if answer is not None:
                with contextlib.suppress(OSError):
                    connection.sendall(answer)

    kept = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve, args=(listening,))
        thread.start()
        try:
            with pytest.raises(OptionError, match="no scheduler of Dask answers"):
                with open_cluster(f"tcp://127.0.0.1:{listening.getsockname()[1]}"):
                    pytest.fail("connected")
        finally:
            listening.shutdown(socket.SHUT_RDWR)
            thread.join()
            for connection in kept:
                connection.close()


@pytest.mark.rig
def test_the_address_of_a_worker_is_one_line(soon):
    with cluster() as found:
        worker = next(iter(found.workers.values())).address
        with pytest.raises(OptionError, match="found a 'Worker' of Dask"), open_cluster(worker):
            pytest.fail("opened")


@pytest.mark.rig
def test_a_cluster_without_workers_is_one_line(soon):
    with cluster(workers=0) as empty:
        with pytest.raises(OptionError, match=r"no worker came to tcp://.* within 1 s; start some, such as: dask"):
            with open_cluster(empty.scheduler_address):
                pytest.fail("opened")


# Versions.

WORKER = """
import asyncio, sys
from jaxscan.fleet import cluster
import distributed

cluster.jaxscan.__version__ = "0.0.7"
cluster.code_digest = lambda: "sha256:" + 64 * "e"

async def work():
    worker = await distributed.Worker(sys.argv[1], nthreads=1, host="127.0.0.1", memory_limit=0)
    await worker.finished()

asyncio.run(work())
"""
"""A process that works for a cluster with another version of the package."""


@pytest.mark.rig
def test_a_worker_with_another_jaxscan_is_refused_with_both_versions(monkeypatch):
    # The process loads the package before it comes.
    monkeypatch.setattr(module, "ANSWER_S", 120.0)
    with cluster(workers=0) as empty:
        command = [sys.executable, "-c", WORKER, empty.scheduler_address]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
            try:
                with pytest.raises(OptionError) as caught, open_cluster(empty.scheduler_address):
                    pytest.fail("opened")
            finally:
                process.kill()
    said = str(caught.value)
    here = code_digest().removeprefix("sha256:")[:12]
    assert "the cluster's worker tcp://127.0.0.1:" in said
    assert f"runs jaxscan 0.0.7 (code eeeeeeeeeeee), and here is {__version__} (code {here})" in said
    assert "\n" not in said


class Asked:
    """Stands for a client of a cluster: what Dask says of its parts, and what our own function answers there."""

    def __init__(self, scheduler=None, dask=None, answer=None):
        here = versions_here()
        packages = {**here, "python": sys.version.split()[0]}
        self.versions = {
            "scheduler": {"packages": packages | (scheduler or {})},
            "workers": {"tcp://w:1": {"packages": packages | (dask or {})}},
        }
        self.answer = answer if isinstance(answer, Exception) else here | (answer or {})

    def get_versions(self, packages):
        return self.versions

    def run(self, function, on_error):
        assert function is versions_here and on_error == "return"
        return {"tcp://w:1": self.answer}


def test_the_same_everywhere_is_silent():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_versions(Asked())
        check_versions(Asked(scheduler={"jax": None, "numpy": None}))  # It computes nothing.


HERE = versions_here()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"dask": {"dask": "2020.1.0"}}, f"worker tcp://w:1 runs dask 2020.1.0, and here is {HERE['dask']}"),
        ({"scheduler": {"distributed": "1.0"}}, "the cluster's scheduler runs distributed 1.0, and here is"),
        ({"scheduler": {"python": "3.8.1.final.0"}}, f"scheduler runs Python 3.8, and here is {HERE['Python']}"),
        ({"answer": {"Python": "3.99"}}, f"worker tcp://w:1 runs Python 3.99, and here is {HERE['Python']}"),
        ({"answer": {"jaxscan": "9"}}, f"runs jaxscan 9, and here is {HERE['jaxscan']}"),
        ({"answer": ModuleNotFoundError("jaxscan")}, "w:1 has no jaxscan that knows batches (ModuleNotFoundError)"),
    ],
)
def test_a_difference_that_matters_is_one_line_with_both_versions(asked, says):
    with pytest.raises(OptionError) as caught:
        check_versions(Asked(**asked))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("package", ["jax", "jaxlib", "numpy"])
def test_other_rounding_is_a_warning(package):
    with pytest.warns(RuntimeWarning, match=rf"tcp://w:1 computes with {package} 0\.1, and here is {HERE[package]}"):
        check_versions(Asked(answer={package: "0.1"}))


def test_every_file_of_the_package_is_in_its_digest(tmp_path, monkeypatch):
    source, copy = Path(jaxscan.__file__).parent, tmp_path / "copy"
    shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__", "data"))
    digest = code_digest.__wrapped__
    monkeypatch.setattr(steps.resources, "files", lambda package: copy)
    original = digest()
    assert original.startswith("sha256:") and digest() == original
    for file in (copy / "__init__.py", copy / "fleet" / "cluster.py", copy / "stripes" / "engine.py"):
        text = file.read_text()
        file.write_text(text + "#")
        assert digest() != original
        file.write_text(text)
    # Code that was moved is another package too.
    (copy / "errors.py").rename(copy / "mistakes.py")
    assert digest() != original
