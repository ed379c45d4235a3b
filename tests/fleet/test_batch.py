"""A batch: which workers get its steps, workers that are gone, unfit or killed, and whole batches on a cluster."""

import json
import os
import threading
import time
from pathlib import Path

import distributed
import pytest

from jaxscan.errors import FleetError
from jaxscan.fleet import batch as module
from jaxscan.fleet.batch import ACCELERATOR, UnfitWorker, by_resource, run_batch
from jaxscan.fleet.cluster import open_cluster
from jaxscan.project import Catalogue, Order, Step, begun_row, load_project, order_of, row_to_json
from tests.fleet.clusters import scheduler, worker
from tests.opened import catalogue_of, edit, products, states, work


ORDERS = [
    Order(Step(f"{kind}/a", kind, (), {}, {}, (), {}), "sha256:0", {}, "")
    for kind in ("calibration", "stripes", "cloud", "mesh", "station", "merged e57")
]


def test_accelerators_take_the_stripes():
    (wanted, special), (anywhere, others) = by_resource(ORDERS, accelerated=True)
    assert wanted == {ACCELERATOR: 1} and [order.step.kind for order in special] == ["stripes", "cloud", "station"]
    assert anywhere is None and [order.step.kind for order in others] == ["calibration", "mesh", "merged e57"]


def test_without_accelerators_all_go_anywhere():
    assert by_resource(ORDERS, accelerated=False) == [(None, ORDERS)]


class Silent:
    """Shows nothing."""

    def working(self, key, done, total):
        pass

    def finished(self, row):
        pass


@pytest.fixture
def lonely(monkeypatch):
    """The client of a scheduler without workers."""
    monkeypatch.setattr(module, "LOOK_S", 0.1)
    monkeypatch.setattr(module, "WARN_S", 0.3)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address="127.0.0.1:0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def batch(file, client, patience_s):
    edit(file, '["cloud", "measures", "mesh"]', '["cloud"]')
    catalogue = catalogue_of(file)
    todo = [order_of(status, load_project(file).output) for status in states(file).values()]
    try:
        return run_batch(todo, catalogue, client, Silent(), patience_s=patience_s)
    finally:
        catalogue.close()


def test_nobody_comes(museum, lonely):
    with pytest.warns(RuntimeWarning, match="no worker of the cluster has worked"):
        with pytest.raises(FleetError, match="call the same command") as caught:
            batch(museum, lonely, patience_s=1.0)
    assert "\n" not in str(caught.value)
    assert {one.state for one in states(museum).values()} == {"missing"}


@pytest.mark.more
def test_somebody_comes_late(museum, lonely):
    def hire():
        time.sleep(1.0)
        lonely.cluster.scale(1)

    threading.Thread(target=hire).start()
    with pytest.warns(RuntimeWarning, match="the batch waits for one at most 2 min"):
        report = batch(museum, lonely, patience_s=120.0)
    assert [row.state for row in report.rows] == ["done", "done"]


def order(number, output="/tmp"):
    step = Step(f"cloud/room-{number}", "cloud", (), {}, {}, (), {})
    return Order(step, f"sha256:{number:064x}", {}, str(output))


def done(text):
    """Work that makes nothing."""
    return row_to_json(begun_row(Order.from_json(text))._replace(state="done"))


def done_by_the_second(text):
    """The same, by a worker that can, and not by another."""
    worker = distributed.get_worker()
    if worker.name == 0:
        raise UnfitWorker(worker.address, "has another disk")
    time.sleep(0.05)
    return done(text)


def done_in_its_folder(text):
    """A product in the folder of the order."""
    time.sleep(0.3)
    found = Order.from_json(text)
    Path(found.output, found.step.key.replace("/", "-")).touch()
    return done(text)


def deadly(text):
    """Ends its worker, for one of the orders."""
    if Order.from_json(text).step.key == "cloud/room-1":
        os._exit(1)
    return done(text)


@pytest.fixture
def client():
    """Of a cluster of two workers in this process."""
    with (
        distributed.LocalCluster(n_workers=2, processes=False, dashboard_address="127.0.0.1:0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.mark.rig
def test_a_worker_with_other_code_makes_nothing(museum, client, monkeypatch):
    monkeypatch.setattr(module, "LOOK_S", 0.1)
    wanted = states(museum)["cloud/room-1"]
    changed = wanted._replace(parts=wanted.parts | {"code": "sha256:of another version"})
    catalogue, output = catalogue_of(museum), load_project(museum).output
    with pytest.warns(RuntimeWarning, match="runs other code of jaxscan than the batch. It gets no more work"):
        with pytest.raises(FleetError, match="no worker of the cluster came"):
            run_batch([order_of(changed, output)], catalogue, client, Silent(), patience_s=1.0)
    catalogue.close()
    assert not products(museum)
    # It was begun, and nobody made it.
    found = states(museum)["cloud/room-1"]
    assert found.state == "missing"


@pytest.mark.rig
def test_what_an_unfit_worker_refuses_others_do(client, tmp_path):
    catalogue = Catalogue(tmp_path / "catalogue.sqlite", "rooms")
    with pytest.warns(RuntimeWarning, match="has another disk. It gets no more work"):
        report = run_batch([order(k) for k in range(20)], catalogue, client, Silent(), work=done_by_the_second)
    assert len(report.rows) == 20 and not report.failed
    assert {row.state for row in catalogue.rows()} == {"done"}
    catalogue.close()


@pytest.mark.rig
def test_two_batches_on_one_cluster_make_both_products(client, tmp_path):
    folders = [tmp_path / name for name in ("first", "second")]

    def run(folder):
        folder.mkdir()
        catalogue = Catalogue(folder / "catalogue.sqlite", "rooms")
        run_batch([order(1, folder)], catalogue, client, Silent(), work=done_in_its_folder)
        catalogue.close()

    threads = [threading.Thread(target=run, args=(folder,)) for folder in folders]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all((folder / "cloud-room-1").exists() for folder in folders)


@pytest.mark.rig
def test_an_answer_that_is_gone_with_its_worker_is_not_waited_for_without_end(client, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LOOK_S", 0.1)
    gather = client.gather

    def late(futures, errors):
        """All workers end before they are asked for what they have."""
        client.run(lambda dask_worker: dask_worker.loop.add_callback(dask_worker.close))
        while client.scheduler_info()["workers"]:
            time.sleep(0.05)
        return gather(futures, errors=errors)

    monkeypatch.setattr(client, "gather", late)
    catalogue = Catalogue(tmp_path / "catalogue.sqlite", "rooms")
    with pytest.raises(FleetError, match="no worker of the cluster came"):
        run_batch([order(1)], catalogue, client, Silent(), patience_s=1.0, work=done)
    assert [row.state for row in catalogue.rows()] == ["begun"]
    catalogue.close()


@pytest.mark.rig
@pytest.mark.slow
def test_a_step_that_ends_its_workers_is_the_only_one_that_fails(tmp_path):
    catalogue = Catalogue(tmp_path / "catalogue.sqlite", "rooms")
    with open_cluster(workers=2) as client:
        report = run_batch([order(k) for k in range(12)], catalogue, client, Silent(), work=deadly)
    catalogue.close()
    assert [row.key for row in report.failed] == ["cloud/room-1"] and len(report.rows) == 12
    assert "its workers died" in report.failed[0].message


@pytest.fixture(scope="module")
def address():
    """The address of a running cluster."""
    with scheduler() as (_, place), worker(place):
        yield place


@pytest.mark.rig
def test_a_batch_on_a_running_cluster(museum, address, run, tmp_path):
    ran = run("batch", museum, "--cluster", address, "--json", "-")
    assert ran.code == 0, ran.err
    assert "2 captures, 6 steps: 6 missing" in ran.err and "6 steps done" in ran.err
    result = json.loads(ran.out)
    assert result["failed"] == {} and sorted(result["done"]) == sorted(states(museum))
    made = products(museum)
    assert len(made) == 8
    # The same as one process makes, to the last byte.
    edit(museum, 'name = "museum"', 'name = "museum"\noutput = "alone"')
    assert all(row.state == "done" for row in work(museum))
    assert products(museum) == made
    edit(museum, '\noutput = "alone"', "")
    # Nothing is done twice.
    before = catalogue_of(museum).rows()
    ran = run("batch", museum, "--cluster", address)
    assert ran.code == 0 and "6 done" in ran.out
    assert catalogue_of(museum).rows() == before


@pytest.mark.rig
def test_what_failed_is_a_line_and_what_needs_it_is_not_begun(museum, address, run):
    for image in (museum.parent / "room-1").glob("*/*"):
        image.unlink()
    ran = run("batch", museum, "--cluster", address)
    assert ran.code == 1
    failed = [line for line in ran.out.splitlines() if line.startswith("failed: ")]
    assert len(failed) == 1 and failed[0].startswith("failed: cloud/room-1: ")
    assert "1 step failed, 2 steps behind not begun" in ran.err and ran.err.count("\n") == 1
    found = {key: one.state for key, one in states(museum).items()}
    assert found == {
        "cloud/room-1": "failed",
        "measures/room-1": "missing",
        "mesh/room-1": "missing",
        "cloud/room-2": "done",
        "measures/room-2": "done",
        "mesh/room-2": "done",
    }
