"""Levels of detail: every point once, coarse ones spread evenly."""

import tracemalloc

import numpy as np
import pytest

from jaxscan.viewer.levels import DEPTH, make_levels


SEED = 7


def shell(points):
    """Points on the sides of a box, m."""
    rng = np.random.default_rng(SEED)
    way = rng.normal(size=(points, 3))
    return (way / np.abs(way).max(1, keepdims=True) * [2.6, 2.2, 1.3]).astype(np.float32)


def test_every_point_comes_once():
    xyz = shell(50_000)
    levels = make_levels(xyz, overview=2_000)
    assert np.array_equal(np.sort(levels.order), np.arange(len(xyz)))
    stops = [chunk.stop for chunk in levels.chunks]
    assert [chunk.start for chunk in levels.chunks] == [0, *stops[:-1]] and stops[-1] == len(xyz)
    first = [chunk for chunk in levels.chunks if np.isinf(chunk.gap)]
    assert len({chunk.tile for chunk in levels.chunks}) == len(first)
    assert sum(chunk.stop - chunk.start for chunk in first) <= 2_000
    for before, after in zip(levels.chunks, levels.chunks[1:], strict=False):
        if after.tile == before.tile:
            assert after.gap == before.spacing and after.spacing < before.spacing
    for chunk in levels.chunks:
        apart = xyz[levels.order[chunk.start : chunk.stop]] - chunk.centre
        assert np.linalg.norm(apart, axis=1).max() <= chunk.radius * (1 + 1e-5)


def test_coarse_points_are_one_in_each_cell_of_the_surface():
    """Against counting: the cells that the whole cloud crosses are those of its first points."""
    xyz = shell(200_000)
    levels = make_levels(xyz, overview=3_000)
    first = np.concatenate([levels.order[c.start : c.stop] for c in levels.chunks if np.isinf(c.gap)])
    low, extent = xyz.min(0), float(np.ptp(xyz, axis=0).max())
    cell = min(c.spacing for c in levels.chunks if np.isinf(c.gap))
    # As the cube is divided: into 2^DEPTH - 1 steps.
    steps = np.floor((xyz - low) * ((2**DEPTH - 1) / extent)).astype(int)
    cells = steps // round(2**DEPTH * cell / extent)
    assert len(np.unique(cells, axis=0)) == len(first)
    assert len(np.unique(cells[first], axis=0)) == len(first)


def test_spacing_is_that_of_the_points():
    """A square of 1 m with n points has one in each 1 / n square metre."""
    rng = np.random.default_rng(SEED)
    xyz = np.column_stack([rng.uniform(size=(40_000, 2)), np.zeros(40_000)]).astype(np.float32)
    levels = make_levels(xyz, overview=4_000)
    # The last one of a tile is the finest.
    finest = {chunk.tile: chunk.spacing for chunk in levels.chunks}
    assert np.median(list(finest.values())) == pytest.approx(1 / 200, rel=0.1)


@pytest.mark.parametrize("xyz", [np.zeros((1, 3)), np.zeros((5, 3)), np.array([[0.0, 0, 0], [1, 1, 1]])])
def test_hardly_any_points(xyz):
    levels = make_levels(xyz.astype(np.float32))
    assert sorted(levels.order.tolist()) == list(range(len(xyz)))
    assert all(np.isfinite([c.radius, c.spacing]).all() and c.spacing > 0 for c in levels.chunks)


def test_levels_take_little_memory_beside_the_points():
    """A point takes 4 bytes of its number and 2 of its tile; the codes are those of one tile at a time."""
    xyz = shell(1_000_000)
    tracemalloc.start()
    try:
        make_levels(xyz)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # Blocks of 2^18 points take 10 bytes for each of the million.
    assert peak < 20 * len(xyz)
