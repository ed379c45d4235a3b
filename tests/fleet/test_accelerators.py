"""Steps that find stripes go to workers with an accelerator, where there are any; others go anywhere."""

from jaxscan.fleet.batch import ACCELERATOR, by_resource
from jaxscan.project import Order, Step


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
