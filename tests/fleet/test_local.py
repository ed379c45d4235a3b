"""The cluster of this machine: each worker on cores of its own, also after a restart, and strangers are not heard."""

import os
import signal
import socket
import time

import jax
import psutil
import pytest

from jaxscan.errors import OptionError
from jaxscan.fleet import ClusterChoice, open_cluster
from jaxscan.fleet.clusters.checks import GIB, WorkerSizes, sizes_for
from jaxscan.fleet.clusters.pinning import share_of
from jaxscan.fleet.clusters.running import connected, cores


pytestmark = pytest.mark.rig


def told_by_worker(dask_worker):
    """Of a worker that has computed something: its process, the cores of all threads, and words of its caller."""
    jax.numpy.ones(8).sum().block_until_ready()
    threads = {frozenset(os.sched_getaffinity(int(thread))) for thread in os.listdir("/proc/self/task")}
    limit = dask_worker.memory_manager.memory_limit
    told = os.environ["JAXSCAN_TEST_WORD"], jax.config.jax_compilation_cache_dir
    return os.getpid(), threads, told, limit, os.environ["OMP_NUM_THREADS"]


def addresses(client):
    return {worker["name"]: place for place, worker in client.scheduler_info(-1)["workers"].items()}


def told_by_name(client):
    told = client.run(told_by_worker)
    return {name: told[place] for name, place in addresses(client).items()}


@pytest.fixture(scope="module")
def client():
    before = dict(os.environ)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAXSCAN_TEST_WORD", "from the caller")
        with open_cluster(ClusterChoice(workers=2, memory_gib=0.5)) as client:
            yield client
            workers = [told[0] for told in told_by_name(client).values()]
    assert not any(psutil.pid_exists(worker) for worker in workers)
    assert dict(os.environ) == before


def test_a_worker_has_its_share_of_cores_memory_and_environment(client):
    told = told_by_name(client)
    mine = os.sched_getaffinity(0)
    assert set(told) == {0, 1}
    cache = os.environ.get("JAX_COMPILATION_CACHE_DIR") or jax.config.jax_compilation_cache_dir
    assert cache
    for name, (_, threads, words, limit, share) in told.items():
        assert threads == {frozenset(share_of(name, 2, mine))}
        assert words == ("from the caller", cache)
        assert limit == GIB // 2
        assert int(share) == -(-cores() // 2)


def test_ctrl_c_at_the_terminal_is_for_the_caller_alone(client):
    before = told_by_name(client)
    for told in before.values():
        os.kill(told[0], signal.SIGINT)
    assert told_by_name(client) == before


def hold(memory):
    """A task that takes more memory than its worker may have."""
    held = bytearray(b"1") * memory
    time.sleep(60)
    return len(held)


@pytest.mark.slow
def test_a_worker_over_its_limit_is_replaced_and_nothing_goes_to_the_disk(client):
    before, place = told_by_name(client), addresses(client)[1]
    # At that address only: the successor, which has another, does not try it again.
    task = client.submit(hold, GIB, workers=[place], allow_other_workers=False)
    while addresses(client).get(1, place) == place:  # Ended by the time limit of tests.
        time.sleep(0.1)
    task.release()
    after = told_by_name(client)
    assert after[1][0] != before[1][0] and after[1][1:] == before[1][1:]
    assert after[0] == before[0]
    assert not any(client.run(spills).values())


def spills(dask_worker):
    manager = dask_worker.memory_manager
    return manager.memory_target_fraction or manager.memory_spill_fraction or manager.memory_pause_fraction


def test_the_successor_of_a_killed_worker_has_its_cores_too(client):
    before, place = told_by_name(client), addresses(client)[0]
    os.kill(before[0][0], signal.SIGKILL)
    while addresses(client).get(0, place) == place:  # Ended by the time limit of tests.
        time.sleep(0.1)
    after = told_by_name(client)
    assert after[0][0] != before[0][0]
    assert after[0][1] == before[0][1]
    assert after[1] == before[1]


def test_all_listens_on_the_loopback(client):
    processes = [psutil.Process(), *(psutil.Process(told[0]) for told in told_by_name(client).values())]
    places = [c.laddr.ip for p in processes for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
    assert len(places) >= 3, "scheduler and two workers"
    assert set(places) == {"127.0.0.1"}


def test_nobody_serves_a_page(client):
    """Dask's HTTP knows no password, and without its dashboard too it tells what all do."""
    told = client.run(lambda dask_worker: (os.getpid(), dask_worker.http_server.port))
    scheduler = client.cluster.scheduler
    pages = {os.getpid(): scheduler.http_server.port, **dict(told.values())}
    assert len(pages) == 3
    for pid, port in pages.items():
        listening = psutil.Process(pid).net_connections()
        assert port not in {c.laddr.port for c in listening if c.status == psutil.CONN_LISTEN}
        with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port), timeout=5.0):
            pass


def test_another_user_of_the_machine_is_not_heard(client, monkeypatch):
    monkeypatch.setattr("jaxscan.fleet.clusters.running.ANSWER_S", 1.0)
    address = client.scheduler.address.replace("tls://", "tcp://")
    with pytest.raises(OptionError, match="no scheduler of Dask answers"), connected(address):
        raise AssertionError("connected")


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
