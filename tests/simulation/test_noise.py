"""The noise of the sensor follows the normal law, and the spline of a print is the one of its formula."""

from statistics import NormalDist

import numpy as np
import pytest

from jaxscan.simulation.boards import between_cells
from jaxscan.simulation.camera import gaussian


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


@pytest.fixture(scope="module")
def drawn() -> np.ndarray:
    return gaussian((1 << 22,), _rng(3)).astype(np.float64)


def test_moments(drawn):
    # Five standard deviations of each mean.
    for power, expected, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((drawn**power).mean() - expected) < 5 * np.sqrt(variance / drawn.size)


@pytest.mark.parametrize("limit", [0.5, 1.0, 2.0, 3.05, 3.15, 3.5, 4.0, 4.5])
def test_share_beyond(drawn, limit):
    for side in (-drawn, drawn):
        expected = drawn.size * NormalDist().cdf(-limit)
        # Five standard deviations, and two cells: a number stands for its cell.
        assert abs((side > limit).sum() - expected) < 5 * np.sqrt(expected) + drawn.size * 2 / 65536


def test_neighbours_are_independent(drawn):
    for step in (1, 2, 3, 4, 640):
        # Five standard deviations.
        assert abs((drawn[step:] * drawn[:-step]).mean()) < 5 / np.sqrt(drawn.size)


@pytest.mark.parametrize("shape", [(0,), (1,), (3, 5), (7, 2, 3)])
def test_any_shape_and_the_same_again(shape):
    first, again, other = (gaussian(shape, _rng(seed)) for seed in (1, 1, 2))
    assert first.shape == shape and first.dtype == np.float32
    np.testing.assert_array_equal(first, again)
    assert first.size == 0 or not np.array_equal(first, other)


def test_spline_is_that_of_its_formula():
    rng = np.random.default_rng(5)
    cells = rng.random((9, 12), np.float32)
    # Beyond the last cells but one too.
    row, column = (rng.uniform(-2, size + 2, 500).astype(np.float32) for size in cells.shape)
    out = between_cells(cells, row, column)

    def weights(places: np.ndarray, size: int) -> np.ndarray:
        """Of all cells: the quadratic B-spline of the distance from each."""
        distance = np.abs(np.clip(places.astype(np.float64), 1, size - 2)[:, None] - np.arange(size))
        return np.where(distance < 0.5, 0.75 - distance**2, np.where(distance < 1.5, (1.5 - distance) ** 2 / 2, 0))

    expected = np.einsum("nr,rc,nc->n", weights(row, 9), cells, weights(column, 12))
    # A few roundings of numbers below 1.
    np.testing.assert_allclose(out, expected, atol=1e-6)


def test_no_place_leads_out_of_the_picture():
    strange = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30], np.float32)
    row, column = (part.ravel() for part in np.meshgrid(strange, strange))
    out = between_cells(np.full((4, 5), 0.5, np.float32), row, column)
    np.testing.assert_allclose(out, 0.5)
