"""Deviations from a plane, and distances of single points."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxscan.errors import MeasurementError
from jaxscan.measurement import measure_deviations, measure_points


def dented(noise, seed=0, spacing=0.01):
    """The wall x = 3 with a dent 4 mm deep and 0.3 m wide, and a bump of 2 mm, on a grid 1 cm wide."""
    y, z = np.meshgrid(np.arange(-60, 61) * spacing + 0.005, np.arange(-60, 61) * spacing + 0.005, indexing="ij")
    shape = 4e-3 * ((np.abs(y) < 0.15) & (np.abs(z - 0.1) < 0.15)) - 2e-3 * ((y > 0.3) & (z < -0.3))
    xyz = np.stack([3.0 + shape, y, z], -1)
    reach = np.linalg.norm(xyz, axis=-1, keepdims=True)
    noisy = xyz * (1.0 + noise * np.random.default_rng(seed).normal(size=reach.shape) / reach)
    return SimpleNamespace(
        xyz=noisy,
        sigma_random=np.full(y.shape, max(noise, 1e-6)),
        valid=np.ones(y.shape, bool),
        laser=np.zeros(len(y), np.int32),
        angle=y[:, 0],
    )


def truth(found):
    """What the cells should hold: x is behind the wall, and towards the scanner is positive."""
    rows, columns = found.seen.shape
    at = found.origin_m + found.cell_m * (
        np.arange(columns)[None, :, None] * found.across + np.arange(rows)[:, None, None] * found.up
    )
    y, z = at[..., 1], at[..., 2]
    return -4e-3 * ((np.abs(y) < 0.15) & (np.abs(z - 0.1) < 0.15)) + 2e-3 * ((y > 0.3) & (z < -0.3))


def test_a_dent_is_found_exactly():
    found = measure_deviations(dented(0.0), [3.0, 0.0, 0.0], radius_m=0.5)
    np.testing.assert_allclose(found.normal, [-1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.up, [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(found.deviation_m[found.seen], truth(found)[found.seen], atol=1e-9)
    assert found.least_m == pytest.approx(-4e-3, abs=1e-9) and found.most_m == pytest.approx(2e-3, abs=1e-9)
    # Cells of 5 x 5 points within the circle; all but those that it cuts are whole.
    assert found.seen.mean() == pytest.approx(np.pi / 4, abs=0.1) and found.points.max() == 25


def test_sigmas_of_cells_are_honest():
    whitened = []
    for seed in range(3):
        found = measure_deviations(dented(1e-3, seed), [3.0, 0.0, 0.0], radius_m=0.5)
        whitened.append((found.deviation_m - truth(found))[found.seen] / found.sigma_m[found.seen])
    # Some 900 cells: 5 sigma of the root mean square is 0.12; a few cells are cut by the edge of the dent.
    assert np.sqrt(np.mean(np.square(np.concatenate(whitened)))) == pytest.approx(1.0, abs=0.12)
    assert found.sigma_m[found.seen].min() > 0 and not found.sigma_m[~found.seen].any()


def test_noise_that_lines_share_is_counted():
    alone, shared = dented(1e-3), dented(1e-3)
    shared.sigma_row, shared.shared_lines = shared.sigma_random, np.full(shared.valid.shape, 5.0)
    first, second = (measure_deviations(each, [3.0, 0.0, 0.0], radius_m=0.3) for each in (alone, shared))
    whole = (first.points == 25) & (second.points == 25)
    # Five lines of a cell are as good as one.
    assert np.median(second.sigma_m[whole] / first.sigma_m[whole]) == pytest.approx(np.sqrt(5.0), rel=0.05)


def test_refusals_of_planes():
    with pytest.raises(MeasurementError, match="Only 0 points"):
        measure_deviations(dented(0.0), [0.0, 0.0, 0.0])
    line = dented(0.0)
    line.valid = np.zeros_like(line.valid)
    line.valid[60] = True
    with pytest.raises(MeasurementError, match="no plane"):
        measure_deviations(line, [3.0, 0.0, 0.0])
    with pytest.raises(MeasurementError, match="larger cells"):
        measure_deviations(dented(0.0), [3.0, 0.0, 0.0], cell_m=1e-3)
    with pytest.raises(MeasurementError, match="too many"):
        measure_deviations(dented(0.0), [3.0, 0.0, 0.0], cell_m=1e-5)


def test_points_and_their_sigma():
    exact = measure_points(dented(0.0), [3.0, -0.495, 0.005], [3.0, 0.505, 0.005])
    assert exact.value_m == pytest.approx(1.0, abs=1e-12) and exact.sigma_systematic_m == 0.0
    values = [measure_points(dented(2e-3, seed), [3.0, -0.495, 0.005], [3.0, 0.505, 0.005]) for seed in range(60)]
    whitened = [(each.value_m - 1.0) / each.sigma_m for each in values]
    # The noise is along rays that are nearly across the distance: 0.3 mm each of 2 mm, and the floor of 0.1 mm that is
    # assumed of surfaces and not drawn here. 60 draws: 0.82 ... 1.18 in 95 % of cases.
    assert 0.65 < np.sqrt(np.mean(np.square(whitened))) < 1.25


def test_refusals_of_points():
    with pytest.raises(MeasurementError, match="nearest"):
        measure_points(dented(0.0), [2.0, 0.0, 0.0], [3.0, 0.5, 0.0])
    with pytest.raises(MeasurementError, match="same nearest"):
        measure_points(dented(0.0), [3.0, 0.0, 0.0], [3.001, 0.0, 0.0])
