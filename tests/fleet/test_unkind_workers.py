"""Workers that can do nothing for a batch, steps that end their workers, and two batches on one cluster."""

import os
import threading
import time
from pathlib import Path

import distributed
import pytest

from jaxscan.errors import FleetError
from jaxscan.fleet import batch
from jaxscan.fleet.batch import UnfitWorker, run_batch
from jaxscan.project import Catalogue, Order, Step, begun_row, load_project, order_of, row_to_json
from tests.fleet.test_absence import Silent
from tests.opened import catalogue_of, products, states


pytestmark = pytest.mark.rig


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


def test_a_worker_with_other_code_makes_nothing(museum, client, monkeypatch):
    monkeypatch.setattr(batch, "LOOK_S", 0.1)
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


def test_what_an_unfit_worker_refuses_others_do(client, tmp_path):
    catalogue = Catalogue(tmp_path / "catalogue.sqlite", "rooms")
    with pytest.warns(RuntimeWarning, match="has another disk. It gets no more work"):
        report = run_batch([order(k) for k in range(20)], catalogue, client, Silent(), work=done_by_the_second)
    assert len(report.rows) == 20 and not report.failed
    assert {row.state for row in catalogue.rows()} == {"done"}
    catalogue.close()


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


def test_an_answer_that_is_gone_with_its_worker_is_not_waited_for_without_end(client, tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "LOOK_S", 0.1)
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


@pytest.mark.slow
def test_a_step_that_ends_its_workers_is_the_only_one_that_fails(tmp_path):
    from jaxscan.fleet import ClusterChoice, open_cluster

    catalogue = Catalogue(tmp_path / "catalogue.sqlite", "rooms")
    with open_cluster(ClusterChoice(workers=2)) as client:
        report = run_batch([order(k) for k in range(12)], catalogue, client, Silent(), work=deadly)
    catalogue.close()
    assert [row.key for row in report.failed] == ["cloud/room-1"] and len(report.rows) == 12
    assert "its workers died" in report.failed[0].message
