"""A batch whose workers are gone: it waits for others, says so, and ends when it was long enough."""

import threading
import time

import distributed
import pytest

from jaxscan.errors import FleetError
from jaxscan.fleet import batch as module
from jaxscan.fleet.batch import run_batch
from jaxscan.project import load_project, order_of
from tests.opened import catalogue_of, edit, states


class Silent:
    """Shows nothing."""

    def working(self, key, done, total):
        pass

    def finished(self, row):
        pass


@pytest.fixture
def client(monkeypatch):
    """Of a scheduler without workers."""
    monkeypatch.setattr(module, "LOOK_S", 0.1)
    monkeypatch.setattr(module, "TOLD_S", 0.3)
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


def test_nobody_comes(museum, client):
    with pytest.warns(RuntimeWarning, match="no worker of the cluster has worked"):
        with pytest.raises(FleetError, match="call the same command") as caught:
            batch(museum, client, patience_s=1.0)
    assert "\n" not in str(caught.value)
    assert {one.state for one in states(museum).values()} == {"missing"}


def test_somebody_comes_late(museum, client):
    def hire():
        time.sleep(1.0)
        client.cluster.scale(1)

    threading.Thread(target=hire).start()
    with pytest.warns(RuntimeWarning, match="the batch waits for one at most 2 min"):
        report = batch(museum, client, patience_s=120.0)
    assert [row.state for row in report.rows] == ["done", "done"]
