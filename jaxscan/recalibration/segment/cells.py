"""The grid of a sweep, averaged over small blocks: cells."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, stripe_pixel
from jaxscan.recalibration.adjust import triangulate_points
from jaxscan.recalibration.observed import SweepStripes


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
    """Stripes of one laser averaged over blocks of the grid; zero where not valid."""

    laser: int
    profiles: Int[np.ndarray, " profiles"]
    """The sweep's profiles of this laser."""
    lines: Int[np.ndarray, " lines"]
    """The lines that have stripes."""
    block: tuple[int, int]
    """Profiles and lines of a block."""
    q: Float[np.ndarray, "rows columns 2"]
    """Mean pixel [px]."""
    phi: Float[np.ndarray, "rows columns"]
    """Mean angle of the table [rad]."""
    sigma_px: Float[np.ndarray, "rows columns"]
    """Standard deviation of the mean centre [px]."""
    p: Float[np.ndarray, "rows columns 3"]
    """Point of the mean [m], scanner frame."""
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


def cells_of(sweep: SweepStripes, scanner: Scanner, correction: Float[np.ndarray, " records"]) -> list[Cells]:
    """The cells of every laser of a sweep.

    A flat wall stays flat: over a block the centre is linear in angle and line to 0.01 pixels, so the mean centre
    lies at the mean angle and the mean line.

    Args:
        sweep: The stripes.
        scanner: The calibrated rig.
        correction: Added to the angle of every record [rad].
    """
    found = []
    for laser in np.unique(sweep.laser):
        profiles = np.flatnonzero(sweep.laser == laser)
        found.append(_cells(sweep, scanner, correction, int(laser), profiles))
    return found


def _cells(sweep: SweepStripes, scanner: Scanner, correction: np.ndarray, laser: int, profiles: np.ndarray) -> Cells:
    # Lines without the laser's colour have no stripes.
    seen = np.count_nonzero(sweep.valid[profiles], 0)
    lines = np.flatnonzero(seen > _EMPTY * seen.max(initial=0))
    block = max(-(-len(profiles) // MOST_PROFILES), 1), max(-(-len(lines) // MOST_LINES), 1)
    angle = (sweep.angle + correction)[sweep.record[profiles]]
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
    # Of the lines that there are.
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
