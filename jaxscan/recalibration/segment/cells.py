"""The grid of a sweep, averaged over small blocks: cells."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, stripe_pixel
from jaxscan.recalibration.grid import Windows, window_planes
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.triangulate import triangulate_points


MOST_PROFILES, MOST_LINES = 400, 200
"""Cells along profiles and lines at most."""
_FILLED = 0.5
"""Share of the stripes that a cell needs."""
_EMPTY = 0.02
"""Stripes of a line, over those of the fullest line, up to which it is left out."""
_RAGGED = 2.0
"""Scatter within a cell, over that of most cells, from which there is an edge in it."""
_FARTHEST_M = 12.0
_AT_ONCE = 64
"""Rows of cells that are averaged at once, which bounds the memory."""


class Cells(NamedTuple):
    """Stripes of one laser averaged over blocks of its profiles and lines; zero where not valid [px, rad, m]."""

    laser: int
    profiles: Int[np.ndarray, " profiles"]
    lines: Int[np.ndarray, " lines"]
    block: tuple[int, int]
    q: Float[np.ndarray, "rows columns 2"]
    phi: Float[np.ndarray, "rows columns"]
    sigma_px: Float[np.ndarray, "rows columns"]
    """Standard deviation of the mean centre [px]."""
    p: Float[np.ndarray, "rows columns 3"]
    slope: Float[np.ndarray, "rows columns 3"]
    """Shift of the point by a pixel across the line [m/px]."""
    valid: Bool[np.ndarray, "rows columns"]

    def across(self, normal: np.ndarray) -> np.ndarray:
        """Standard deviation of the points along a normal ([3], or one for each cell) [m]."""
        return np.abs((self.slope * normal).sum(-1)) * self.sigma_px

    def spread(self, field: np.ndarray) -> np.ndarray:
        """A field of the cells on this laser's profiles and lines."""
        rows, columns = self.block
        return np.repeat(np.repeat(field, rows, 0), columns, 1)[: len(self.profiles), : len(self.lines)]


def cells_of(sweep: SweepStripes, scanner: Scanner) -> list[Cells]:
    """The cells of every laser of a sweep.

    A flat wall stays flat: over a block the centre is linear in angle and line to 0.01 pixels, so the mean centre
    lies at the mean angle and the mean line.
    """
    return [_cells(sweep, scanner, int(laser)) for laser in np.unique(sweep.laser)]


def _cells(sweep: SweepStripes, scanner: Scanner, laser: int) -> Cells:
    profiles = np.flatnonzero(sweep.laser == laser)
    # Lines of a mosaic that lack the laser's colour have no stripes.
    seen = np.count_nonzero(sweep.valid[profiles], 0)
    lines = np.flatnonzero(seen > _EMPTY * seen.max(initial=0))
    block = max(-(-len(profiles) // MOST_PROFILES), 1), max(-(-len(lines) // MOST_LINES), 1)
    angle = sweep.angle[sweep.record[profiles]]
    many = _AT_ONCE * block[0]
    parts = [
        _averaged(sweep, (profiles[first : first + many], lines), angle[first : first + many], block)
        for first in range(0, len(profiles), many)
    ]
    u, line, phi, sigma, ragged, share = (np.concatenate(field) for field in zip(*parts, strict=True))
    valid = share >= _FILLED
    usual = max(float(np.median(ragged[valid])), 0.5) if valid.any() else 1.0
    freedom = np.maximum(share * block[0] * block[1] - _unknowns(block), 1.0)
    valid &= ragged <= usual * (_RAGGED + 2.0 / np.sqrt(freedom))
    shape = valid.shape
    q = np.asarray(stripe_pixel(u, line, sweep.stripe_axis))
    flat = q.reshape(-1, 2), np.full(valid.size, laser, np.int32), phi.ravel()
    p, exists = triangulate_points(scanner, *flat)
    valid &= exists.reshape(shape)
    beside = np.asarray(stripe_pixel(u + 0.25, line, sweep.stripe_axis))
    moved, _ = triangulate_points(scanner, beside.reshape(-1, 2), *flat[1:])
    p, slope = p.reshape(*shape, 3), ((moved - p) / 0.25).reshape(*shape, 3)
    valid &= np.linalg.norm(p, axis=-1) < _FARTHEST_M
    return Cells(
        laser,
        profiles,
        lines,
        block,
        q,
        phi,
        np.where(valid, sigma, 0.0),
        np.where(valid[..., None], p, 0.0),
        np.where(valid[..., None], slope, 0.0),
        valid,
    )


def _unknowns(block: tuple[int, int]) -> int:
    """Of a straight line through a block: a level, and a slope in each direction that has several stripes."""
    return 1 + (block[0] > 1) + (block[1] > 1)


def _averaged(
    sweep: SweepStripes, grid: tuple[np.ndarray, np.ndarray], angle: np.ndarray, block: tuple[int, int]
) -> tuple[np.ndarray, ...]:
    """Mean centre, line and angle, sigma of the centre, scatter over its promise, and share of stripes, of blocks."""
    profiles, lines = grid
    short = -len(profiles) % block[0], -len(lines) % block[1]
    at = np.ix_(profiles, lines)

    def blocks(field: np.ndarray) -> np.ndarray:
        wide = np.pad(field, ((0, short[0]), (0, short[1])))
        return wide.reshape(wide.shape[0] // block[0], block[0], wide.shape[1] // block[1], block[1])

    valid = sweep.valid[at] & np.isfinite(sweep.centre[at]) & (sweep.sigma[at] > 0)
    centre = np.where(valid, sweep.centre[at], 0.0).astype(np.float64)
    sigma = np.where(valid, sweep.sigma[at], 1.0).astype(np.float64)
    # Taken over the lines that have stripes.
    spacing = np.diff(lines).mean() if len(lines) > 1 else 1.0
    shared = np.where(valid, sweep.shared_lines[at], 1.0).astype(np.float64) / spacing
    w, x = blocks(np.where(valid, sigma**-2.0, 0.0)), blocks(centre)
    full = np.ones_like(centre)
    turn, line = blocks(angle[:, None] * full), blocks(lines.astype(np.float64) * full)

    def total(field: np.ndarray) -> np.ndarray:
        return field.sum((1, 3))

    weight = total(w)
    safe = np.where(weight > 0, weight, 1.0)
    means = [total(w * field) / safe for field in (x, turn, line)]
    x, turn, line = (field - mean[:, None, :, None] for field, mean in zip((x, turn, line), means, strict=True))
    # Scatter around the straight line through the block, in the two directions.
    tt, ll, tl = total(w * turn * turn), total(w * line * line), total(w * turn * line)
    xt, xl, xx = total(w * x * turn), total(w * x * line), total(w * x * x)
    tt, ll = tt + 1e-9 * safe, ll + 1e-6 * safe
    det = tt * ll - tl * tl
    explained = (xt * (ll * xt - tl * xl) + xl * (tt * xl - tl * xt)) / det
    count = total(blocks(valid.astype(np.float64)))
    scatter = np.sqrt(np.maximum(xx - explained, 0.0) / np.maximum(count - _unknowns(block), 1.0))
    together = np.clip(total(w * blocks(shared)) / safe, 1.0, block[1])
    sizes = total(blocks(full))
    return means[0], means[2], means[1], np.sqrt(together / safe), scatter, count / sizes


_HALF_M = 0.12
"""Half the size of a neighbourhood [m]."""
_LEAST, _MOST = 2, 25
"""Cells in half a neighbourhood."""
_FULL = 0.85
"""Share of the cells of a neighbourhood that must be seen."""
ROUGH_M = 1e-3
"""Roughness of walls that is always allowed [m]."""
_CURVED = 0.08
"""Curvature from which a surface is not flat [1/m]; a calibration that is wrong bends walls by less than half of it."""


class Surroundings(NamedTuple):
    """The neighbourhood of each cell; zero where not `even`."""

    windows: Windows
    half: tuple[Int[np.ndarray, "rows columns"], Int[np.ndarray, "rows columns"]]
    normal: Float[np.ndarray, "rows columns 3"]
    """Unit normal, towards the scanner."""
    sigma: Float[np.ndarray, "rows columns"]
    """Standard deviation of a cell along its normal [m], with the factor."""
    scatter: Float[np.ndarray, "rows columns"]
    """RMS distance from the plane of the neighbourhood [m]."""
    even: Bool[np.ndarray, "rows columns"]
    factor: float
    """Factor by which the scatter exceeds the stated sigmas [1]."""


def surroundings(cells: Cells) -> Surroundings:
    """Normals, scatter and flatness of all neighbourhoods."""
    half = _halves(cells)
    windows = Windows.around(*half)
    count, normal, variance = window_planes(cells.p, cells.valid, windows)
    full = cells.valid & (count >= _FULL * windows.area()) & (count >= 9)
    scatter = np.sqrt(variance[..., 0] * count / np.maximum(count - 3.0, 1.0))
    promised = cells.across(normal)
    broad = full & (np.sqrt(variance[..., 1]) > 3.0 * scatter)
    factor = _factor(scatter[broad] / np.maximum(promised[broad], 1e-9))
    sigma = factor * promised
    limit = sigma**2 * (1.0 + 4.0 * np.sqrt(2.0 / np.maximum(count, 3.0))) + ROUGH_M**2
    even = broad & (scatter**2 < limit)
    even &= ~_curved(cells, normal, even, half, sigma / np.sqrt(np.maximum(count, 1.0)))
    return Surroundings(windows, half, np.where(even[..., None], normal, 0.0), sigma, scatter, even, factor)


def _halves(cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Half the size of each neighbourhood, in rows and columns of cells."""
    halves = []
    for axis in (0, 1):
        apart = np.linalg.norm(np.diff(cells.p, axis=axis), axis=-1)
        both = cells.valid[1:] & cells.valid[:-1] if axis == 0 else cells.valid[:, 1:] & cells.valid[:, :-1]
        away = np.linalg.norm(cells.p, axis=-1)
        start = away[:-1] if axis == 0 else away[:, :-1]
        # Steps in angle; over edges they are larger, so the median counts.
        pitch = np.median(apart[both] / start[both]) if both.any() else 1.0
        half = np.round(_HALF_M / np.maximum(pitch * away, 1e-6))
        halves.append(np.where(cells.valid, np.clip(half, _LEAST, _MOST), _LEAST).astype(int))
    return halves[0], halves[1]


def _factor(ratios: np.ndarray) -> float:
    return float(np.clip(np.median(ratios), 1.0, 10.0)) if len(ratios) else 1.0


def _curved(
    cells: Cells,
    normal: np.ndarray,
    even: np.ndarray,
    half: tuple[np.ndarray, np.ndarray],
    sigma: np.ndarray,
) -> np.ndarray:
    """Where normals turn along the surface, in either direction of the grid."""
    rows, columns = even.shape
    i, j = np.broadcast_arrays(np.arange(rows)[:, None], np.arange(columns)[None, :])
    curved = np.zeros_like(even)
    for axis in (0, 1):
        ahead, behind = (_moved(i, j, even, axis, sign * half[axis]) for sign in (1, -1))
        way = cells.p[ahead] - cells.p[behind]
        length = np.linalg.norm(way, axis=-1)
        safe = np.maximum(length, 1e-6)
        turn = np.abs(((normal[ahead] - normal[behind]) * way).sum(-1)) / safe
        # Slopes of a neighbourhood are known to sigma over its own spread.
        noise = 3.0 * np.sqrt(2.0) * sigma * np.sqrt(3.0) / _HALF_M
        curved |= (length > _HALF_M / 2) & (turn > _CURVED * safe + noise)
    return even & curved


def _moved(
    i: np.ndarray, j: np.ndarray, even: np.ndarray, axis: int, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The cells `step` further along an axis; the cells themselves where those are not even."""
    rows, columns = even.shape
    further = np.clip(i + step, 0, rows - 1) if axis == 0 else i, np.clip(j + step, 0, columns - 1) if axis else j
    there = even[further]
    return np.where(there, further[0], i), np.where(there, further[1], j)
