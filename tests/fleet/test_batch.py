"""A batch on a cluster of three processes: a scheduler, a worker, and the verb."""

import json

import pytest

from tests.fleet.clusters import scheduler, worker
from tests.opened import catalogue_of, edit, products, states, work


pytestmark = pytest.mark.rig


@pytest.fixture(scope="module")
def address():
    """The address of a running cluster."""
    with scheduler() as (_, place), worker(place):
        yield place


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
