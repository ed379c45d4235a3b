"""A batch in processes of its own: what runs beside, what fails, what is killed, and what goes on."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxscan.project import Catalogue, Status, Step, begun_row, failed_row, run_batch
from jaxscan.project import batch as module
from tests.opened import catalogue_of, edit, products, states, work


class Told:
    """Keeps the progress of a batch."""

    def __init__(self):
        self.progress, self.rows = [], []

    def working(self, *progress):
        self.progress.append(progress)

    def finished(self, row):
        self.rows.append(row)


def step(key, *inputs):
    return Status(Step(key, "cloud", inputs, {}, {}, (), {}), f"sha256:{key}", {}, "missing", "")


def strange(status, output, progress):
    """Work that a name stands for: done, failed, or the end of its process."""
    progress(1, 2)
    match status.step.key.partition("-")[0]:
        case "failed":
            return failed_row(status, "a line")
        case "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        case "crashed":
            os._exit(3)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0
    return begun_row(status)._replace(state="done", message=f"{os.getpid()} {cores}")


@pytest.fixture
def ran(tmp_path):
    """Runs steps, each named after what becomes of it, and gives report, progress, and rows of the catalogue."""

    def call(*todo, workers=2):
        told, catalogue = Told(), Catalogue(tmp_path / "catalogue.sqlite", "rooms")
        report = run_batch(todo, tmp_path, catalogue, told, workers=workers, work=strange)
        rows = catalogue.rows()
        catalogue.close()
        return report, told, rows

    return call


def test_a_process_that_dies_fails_its_step_alone(ran):
    todo = [step("killed"), step("crashed"), step("done-1"), step("failed"), *(step(f"done-{k}") for k in range(2, 6))]
    report, told, rows = ran(*todo)
    found = {row.key: row for row in report.rows}
    assert {key for key, row in found.items() if row.state == "failed"} == {"killed", "crashed", "failed"}
    assert "needs more memory" in found["killed"].message and "ended with 3" in found["crashed"].message
    assert len(found) == 8 and sorted(row.key for row in rows) == sorted(found)
    assert {row.state for row in rows} == {"done", "failed"} and told.rows == list(report.rows)
    assert ("done-1", 1, 2) in told.progress


def test_what_needs_a_step_comes_after_it_or_not_at_all(ran):
    todo = [step("done"), step("failed"), step("done-after", "done", "elsewhere"), step("done-behind", "failed")]
    todo += [step("done-far-behind", "done-behind", "done")]
    report, told, _ = ran(*todo)
    assert report.left == {"done-behind": "failed", "done-far-behind": "failed"}
    order = [row.key for row in told.rows]
    assert set(order) == {"done", "failed", "done-after"} and order.index("done") < order.index("done-after")


def test_processes_share_the_cores_and_are_kept(ran):
    mine = len(os.sched_getaffinity(0))
    one = {row.message for row in ran(*(step(f"done-{k}") for k in range(4)), workers=1)[0].rows}
    assert len(one) == 1 and one.pop().endswith(f" {mine}")
    two = {row.message for row in ran(*(step(f"done-{k}") for k in range(20)), workers=2)[0].rows}
    assert len(two) <= 2 and sum(int(text.split()[1]) for text in two) <= mine


def test_memory_and_cores_say_how_many_processes_there_are(monkeypatch):
    cores = len(os.sched_getaffinity(0))
    for free, count in ((1 << 50, cores), (1 << 20, 1)):
        monkeypatch.setattr(module, "free_bytes", lambda free=free: free)
        assert module.default_workers() == count
    monkeypatch.undo()
    assert 1 << 20 < module.free_bytes() < 1 << 50


@pytest.mark.more
def test_a_batch_makes_what_one_process_makes(museum, run):
    ran = run("batch", museum, "--json", "-", "--workers", "2")
    assert ran.code == 0, ran.err
    assert "2 captures, 6 steps: 6 missing" in ran.err and "6 steps done" in ran.err
    result = json.loads(ran.out)
    assert result["failed"] == {} and sorted(result["done"]) == sorted(states(museum))
    made = products(museum)
    assert len(made) == 8
    # Nothing is done twice.
    before = catalogue_of(museum).rows()
    ran = run("batch", museum)
    assert ran.code == 0 and "6 done" in ran.out
    assert catalogue_of(museum).rows() == before
    edit(museum, 'name = "museum"', 'name = "museum"\noutput = "alone"')
    assert all(row.state == "done" for row in work(museum))
    assert products(museum) == made


@pytest.mark.more
def test_what_failed_is_a_line_and_what_needs_it_is_not_begun(museum, run):
    for image in (museum.parent / "room-1").glob("*/*"):
        image.unlink()
    edit(museum, '"mesh"]', '"report"]')
    ran = run("batch", museum, "--workers", "1")
    assert ran.code == 1
    failed = [line for line in ran.out.splitlines() if line.startswith("failed: ")]
    assert len(failed) == 1 and failed[0].startswith("failed: cloud/room-1: ")
    assert "1 step failed, 2 steps behind not begun" in ran.err and ran.err.count("\n") == 1
    found = {key: one.state for key, one in states(museum).items()}
    for name, (cloud, others) in {"room-1": ("failed", "missing"), "room-2": ("done", "done")}.items():
        assert found[f"cloud/{name}"] == cloud
        assert found[f"measures/{name}"] == found[f"report/{name}"] == others


def children(process):
    """Processes that a process has started."""
    listed = Path(f"/proc/{process}/task").glob("*/children")
    return [int(one) for file in listed for one in file.read_text().split()]


def has_loaded(process, library):
    try:
        return library in Path(f"/proc/{process}/maps").read_text()
    except (FileNotFoundError, ProcessLookupError):  # It has just ended.
        return False


@pytest.mark.rig
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_batch_that_was_ended_leaves_no_process_and_goes_on(museum, number):
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud"]')
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    words = [sys.executable, "-m", "jaxscan.cli.main", "batch", str(museum), "--workers", "1"]
    first = subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True)
    # A worker that has loaded JAX has read what it is to do: before, it would say that its parent is gone. The time
    # limit of tests ends this loop; a step takes seconds.
    while not any(has_loaded(process, "jaxlib") for process in children(first.pid)):
        assert first.poll() is None
        time.sleep(0.02)
    started = children(first.pid)
    first.send_signal(number)
    _, said = first.communicate()
    assert said == ("jaxscan: interrupted\n" if number == signal.SIGTERM else "")
    for process in started:
        while os.path.exists(f"/proc/{process}"):  # Ended by the time limit of tests.
            time.sleep(0.05)
    second = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=300)
    assert second.returncode == 0, second.stderr
    assert {one.state for one in states(museum).values()} == {"done"}
    assert not list((museum.parent / "products").glob(".part-*"))
