"""Captures read from an S3-compatible server on loopback give the products of local ones."""

import pytest

from jaxscan.fleet.cluster import open_cluster
from tests.fleet.test_batch import Silent
from tests.fleet.test_faults import batch
from tests.opened import edit, products, states, work


pytestmark = [pytest.mark.rig, pytest.mark.slow]


@pytest.fixture
def bucket(monkeypatch):
    """A bucket of moto's server, found as boto3 finds any server."""
    import boto3
    from moto.server import ThreadedMotoServer

    for name, value in {
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    client = boto3.client("s3", region_name="us-east-1")
    client.create_bucket(Bucket="rooms")
    yield client
    server.stop()


def test_a_batch_from_object_storage(museum, bucket):
    edit(museum, 'name = "museum"', 'name = "museum"\noutput = "local"')
    assert all(row.state == "done" for row in work(museum))
    expected = products(museum)
    for path in museum.parent.glob("room-*/**/*"):
        if path.is_file():
            bucket.upload_file(str(path), "rooms", str(path.relative_to(museum.parent)))
    edit(museum, 'output = "local"', 'output = "remote"')
    edit(museum, 'pattern = "room-*"', 'pattern = "s3://rooms/room-*"')
    with open_cluster(workers=2) as client:
        report = batch(museum, client, Silent())
    assert not report.failed and not report.left
    assert products(museum) == expected
    assert {one.state for one in states(museum).values()} == {"done"}
    # What changes there makes stale what is made of it.
    bucket.put_object(Bucket="rooms", Key="room-1/frames.jsonl", Body=b"changed")
    stale = {key for key, one in states(museum).items() if one.state == "stale"}
    assert stale == {"cloud/room-1", "measures/room-1", "mesh/room-1"}
