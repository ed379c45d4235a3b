"""The board captures of the paper's protocol."""

import numpy as np
import pytest

from experiments.paper import products
from experiments.paper.methods import PaperWay
from experiments.paper.products import load_paper_way, save_paper_way
from experiments.paper.stage import Stage, smaller, world


SCALE = 0.5
"""Of the quick worlds' images: frames are compared with each other, and nothing is measured in them."""


@pytest.fixture(params=["kind", "unkind"])
def stage(request, tmp_path) -> Stage:
    config = smaller(world(request.param, quick=True), SCALE)
    return Stage(request.param, config, tmp_path / "work", tmp_path, quick=True)


def last(plan: products.BoardPlan) -> products.BoardPlan:
    """One dark view and the last pair."""
    return products.BoardPlan([plan.placements[0], plan.placements[-1]], [False, True, True])


def test_the_papers_protocol(stage) -> None:
    plan = products.paper_plan(stage)
    jobs = plan.jobs()
    assert len(jobs) == 23
    assert [lit for *_, lit in jobs] == [False] * 19 + [True] * 4
    (first, home, _), (second, turned, _) = jobs[-2:]
    assert first is second
    assert np.rad2deg(turned - home) == pytest.approx(1.98)
    assert all(phi == 0 for _, phi, _ in jobs[:-1])
    again = products.paper_plan(stage)
    for one, other in zip(plan.placements, again.placements, strict=True):
        np.testing.assert_array_equal(one.scanner_from_board.translation, other.scanner_from_board.translation)


def test_a_seed_draws_the_same_frames(stage, tmp_path) -> None:
    plan = last(products.paper_plan(stage))
    records = list(products.expect(stage, plan))
    assert [record.laser.size > 0 for record in records] == [False, True, True]
    written = products.write_captures(stage, records, plan, {1: tmp_path / "one", 2: tmp_path / "other"})
    written[1:1] = products.write_captures(stage, records, plan, {1: tmp_path / "again"})
    assert np.rad2deg(written[0].records[-1].angle) == pytest.approx(1.98)
    for number in range(3):
        one, again, other = (capture.frames(number) for capture in written)
        assert (one[0] is None) == (number == 0)
        for side in range(2):
            if one[side] is not None:
                np.testing.assert_array_equal(one[side], again[side])
                assert not np.array_equal(one[side], other[side])


def test_a_dark_view_is_the_room_without_the_laser(stage) -> None:
    placement = products.paper_plan(stage).placements[-1]
    lit, dark = (products.expect(stage, products.BoardPlan([placement], [state] * 2)) for state in (True, False))
    for one, other in zip(lit, dark, strict=True):
        # Single precision; a DN is 1.
        np.testing.assert_allclose(one.off, other.off, rtol=2e-6, atol=0)
        assert one.laser.max() > 1
        assert other.laser.size == 0


def test_the_papers_calibration_is_kept(tmp_path) -> None:
    random = np.random.default_rng(1)
    stripe = [np.zeros((0, 2)), random.normal(size=(3, 2)), random.normal(size=(2, 2))]
    arrays = [random.normal(size=size) for size in ((3, 3), (3, 4, 4), 3, 3, (4, 4))]
    way = PaperWay(arrays[0], -0.1, arrays[1], stripe, *arrays[2:], 0.03)
    save_paper_way(way, tmp_path / "way.npz")
    found = load_paper_way(tmp_path / "way.npz")
    for name in PaperWay._fields:
        one, other = getattr(way, name), getattr(found, name)
        for each in zip(one, other, strict=True) if name == "stripe" else [(one, other)]:
            np.testing.assert_array_equal(*each)
