"""Whatever dies in the middle: the batch completes, and every product is that of an undisturbed run.

A worker is killed when the first step tells how far it is; the
scheduler when the first step is in the catalogue.
"""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from jaxscan.fleet.batch import run_batch
from jaxscan.fleet.cluster import open_cluster
from jaxscan.project import load_project, order_of
from tests.fleet.clusters import scheduler, worker
from tests.fleet.test_batch import Silent
from tests.opened import catalogue_of, edit, products, states, work


pytestmark = [pytest.mark.rig, pytest.mark.slow]


class Killer(Silent):
    """Kills the worker of the first step that tells how far it is."""

    def __init__(self, client):
        self.client, self.killed = client, threading.Event()

    def working(self, key, done, total):
        if not self.killed.is_set():
            self.killed.set()
            threading.Thread(target=self.kill, args=(key,)).start()

    def kill(self, key):
        busy = [
            place for place, tasks in self.client.processing().items() if any(str(t).startswith(key) for t in tasks)
        ]
        assert busy
        (pid,) = self.client.run(os.getpid, workers=busy[:1]).values()
        os.kill(pid, signal.SIGKILL)


def batch(file, client, show):
    catalogue = catalogue_of(file)
    output = load_project(file).output
    todo = [order_of(status, output) for status in states(file).values() if status.state != "done"]
    try:
        return run_batch(todo, catalogue, client, show)
    finally:
        catalogue.close()


def complete(file, undisturbed):
    """Everything is done once, whole, and equal."""
    assert {one.state for one in states(file).values()} == {"done"}
    catalogue = catalogue_of(file)
    keys = [row.key for row in catalogue.rows()]
    catalogue.close()
    assert sorted(keys) == sorted(set(keys)) == sorted(states(file))
    assert not [path for path in load_project(file).output.glob(".part-*") if any(path.iterdir())]
    return products(file) == undisturbed


@pytest.fixture
def undisturbed(museum):
    """The products as one process makes them, in a folder of their own."""
    edit(museum, 'name = "museum"', 'name = "museum"\noutput = "alone"')
    assert all(row.state == "done" for row in work(museum))
    made = products(museum)
    edit(museum, '\noutput = "alone"', "")
    return made


def test_a_worker_killed_in_the_middle(museum, undisturbed):
    with open_cluster(workers=2) as client:
        killer = Killer(client)
        report = batch(museum, client, killer)
    assert killer.killed.is_set() and not report.failed and not report.left
    assert complete(museum, undisturbed)


def test_the_scheduler_killed_in_the_middle(museum, undisturbed, tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    words = [sys.executable, "-m", "jaxscan.cli.main", "batch", str(museum), "--cluster"]
    with scheduler() as (process, address), worker(address):
        first = subprocess.Popen([*words, address], stderr=subprocess.PIPE, text=True, env=environment)
        deadline = time.monotonic() + 120
        while not any(one.state == "done" for one in states(museum).values()):
            assert time.monotonic() < deadline and first.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
        _, said = first.communicate(timeout=120)
    assert first.returncode == 1 and "call the same command" in said and "Traceback" not in said
    left = {key for key, one in states(museum).items() if one.state != "done"}
    assert left
    with scheduler() as (_, address), worker(address):
        second = subprocess.run([*words, address], capture_output=True, text=True, env=environment, timeout=300)
    assert second.returncode == 0, second.stderr
    assert f"{len(left)} step" in second.stdout
    assert complete(museum, undisturbed)


def test_the_batch_killed_in_the_middle(museum, undisturbed):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    words = [sys.executable, "-m", "jaxscan.cli.main", "batch", str(museum), "--workers", "2"]
    first = subprocess.Popen(words, env=environment)
    deadline = time.monotonic() + 120
    while not any(one.state == "done" for one in states(museum).values()):
        assert time.monotonic() < deadline and first.poll() is None
        time.sleep(0.05)
    first.kill()
    first.wait()
    second = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=300)
    assert second.returncode == 0, second.stderr
    assert complete(museum, undisturbed)
