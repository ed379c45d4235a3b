"""What an order that travelled is worth where it arrives."""

from jaxscan.project import do_step, load_project, order_of
from tests.opened import products, states


def test_a_worker_with_other_code_makes_nothing(museum):
    status = states(museum)["cloud/room-1"]
    changed = status._replace(parts=status.parts | {"code": "sha256:of another version"})
    row = do_step(order_of(changed, load_project(museum).output))
    assert row.state == "failed"
    assert row.message.endswith("runs other code of jaxscan than the batch; install the same there.")
    assert not products(museum)
