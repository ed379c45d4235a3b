"""Steps that find stripes go to workers with an accelerator, where there are any; others go anywhere."""

import json

from jaxscan.fleet.batch import ACCELERATOR, _handed_out
from jaxscan.project import Order, Step


class Cluster:
    """Notes what is handed out."""

    def __init__(self):
        self.sent = {}

    def map(self, work, texts, *, key, resources, **_):
        self.sent |= {json.loads(text)["step"]["key"]: resources for text in texts}
        return list(key)


def orders():
    kinds = ("calibration", "stripes", "cloud", "mesh", "station", "merged e57")
    return [Order(Step(f"{kind}/a", kind, (), {}, {}, (), {}), "sha256:0", {}, "") for kind in kinds]


def test_accelerators_take_the_stripes():
    cluster = Cluster()
    given = dict(_handed_out(cluster, print, orders(), accelerated=True))
    assert sorted(given.values()) == sorted(order.step.key for order in orders())
    assert {key for key, wanted in cluster.sent.items() if wanted == {ACCELERATOR: 1}} == {
        "stripes/a",
        "cloud/a",
        "station/a",
    }
    assert all(wanted in (None, {ACCELERATOR: 1}) for wanted in cluster.sent.values())


def test_without_accelerators_all_go_anywhere():
    cluster = Cluster()
    assert len(dict(_handed_out(cluster, print, orders(), accelerated=False))) == len(orders())
    assert set(cluster.sent.values()) == {None}
