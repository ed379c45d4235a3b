"""The comparisons of two versions of the code: which figure is worse, and which cell of a cloud."""

import numpy as np
import pytest
from compare_clouds import Grid, cell_lines, compare, missed
from stripe_accuracy import Figure, against_lines, change


@pytest.mark.parametrize(
    ("key", "before", "now", "worse"),
    [
        ("cells_1px_20dn_known_rms_over_bound", 1.0, 1.03, True),
        ("cells_1px_20dn_known_rms_over_bound", 1.03, 1.0, False),
        ("cells_1px_20dn_known_valid", 1.0, 0.97, True),
        ("cells_1px_20dn_known_valid", 0.97, 1.0, False),
        ("cells_1px_20dn_known_sigma_over_error", 1.05, 0.99, False),
        ("cells_1px_20dn_known_sigma_over_error", 1.01, 0.96, True),
        ("invented_faint_noise_known", 0.0, 1e-5, True),
        ("invented_faint_noise_rows", 100, 200, False),
        ("faint_known_rms_within_1px", 0.1, float("nan"), True),
    ],
)
def test_a_figure_is_worse_on_its_bad_side_alone(key, before, now, worse):
    assert (not change(key, before, now) <= 0.02) == worse
    assert (against_lines([Figure(key, now, "1")], {key: before})[1] == [key]) == worse


def test_cells_are_counted_by_the_cloud_that_has_them():
    xyz = np.zeros((2, 4, 3), np.float32)
    xyz[..., 2] = 2.0
    sigma = np.full((2, 4), 1e-3, np.float32)
    first = Grid(xyz, np.array([[1, 1, 1, 0], [1, 0, 0, 0]], bool), sigma)
    moved = xyz.copy()
    moved[0, 0, 2] += 0.01
    second = Grid(moved, np.array([[1, 1, 0, 1], [1, 0, 0, 0]], bool), sigma)
    truth = Grid(xyz, np.array([[1, 1, 1, 0], [0, 0, 0, 0]], bool), sigma)
    found = compare(first, second, truth)
    names = ("in both", "only in the first", "only in the second", "over 3 sigma apart")
    assert [found[name] for name in names] == [3, 1, 1, 1]
    assert (found["false points, first"], found["false points, second"]) == (1, 2)
    assert found["false points only in the second"] == 1
    assert found["true points found, second, %"] == pytest.approx(200 / 3)
    assert missed(found) == ["true points found, second, %", "false points, second"]
    assert missed(compare(first, first, truth)) == []
    lines = cell_lines(first, second, truth, 9)
    assert [line.split(", ")[:2] for line in lines] == [
        ["only in the first: profile 0", "line 2"],
        ["only in the second: profile 0", "line 3"],
        ["moved: profile 0", "line 0"],
    ]
