"""Flat regions of the grid of a sweep.

The grid is averaged over small blocks, its cells; neighbours that agree are grown over all that lies on one plane.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, root_of, stripe_pixel
from jaxscan.measurement.planes import facing, weighted_plane
from jaxscan.measurement.systematic import point_gradient
from jaxscan.recalibration.grid import Windows, smooth_parts, spread_over, window_planes
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
    """Unknowns of a straight line through a block: a level, and a slope along each axis that has several stripes."""
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
_LEAST, _MOST_CELLS = 2, 25
"""Cells in half a neighbourhood."""
_FULL = 0.85
"""Share of the cells of a neighbourhood that must be seen."""
ROUGH_M = 1e-3
"""Roughness of walls that is always allowed [m]."""
_BENT = 0.08
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
        halves.append(np.where(cells.valid, np.clip(half, _LEAST, _MOST_CELLS), _LEAST).astype(int))
    return halves[0], halves[1]


def _factor(ratios: np.ndarray) -> float:
    return float(np.clip(np.median(ratios), 1.0, 10.0)) if len(ratios) else 1.0


def _curved(
    cells: Cells, normal: np.ndarray, even: np.ndarray, half: tuple[np.ndarray, np.ndarray], sigma: np.ndarray
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
        curved |= (length > _HALF_M / 2) & (turn > _BENT * safe + noise)
    return even & curved


def _moved(
    i: np.ndarray, j: np.ndarray, even: np.ndarray, axis: int, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The cells `step` further along an axis; the cells themselves where those are not even."""
    rows, columns = even.shape
    further = np.clip(i + step, 0, rows - 1) if axis == 0 else i, np.clip(j + step, 0, columns - 1) if axis else j
    there = even[further]
    return np.where(there, further[0], i), np.where(there, further[1], j)


_LOOSE = {
    "n1": 1e-3,
    "n2": 1e-3,
    "d": 3e-4,
    "axis.d1": 1e-3,
    "axis.d2": 1e-3,
    "axis.p1": 3e-4,
    "axis.p2": 3e-4,
    "gain": 2e-4,
    "c1": 3e-4,
    "s1": 3e-4,
    "c2": 3e-4,
    "s2": 3e-4,
}
"""Standard deviations of a drift that no covariance states, by which walls may be bent as well [rad, m]."""
_DIRECTIONS = 24
"""Directions of the covariance that are used at most."""


def likely_steps(scanner: Scanner) -> Float[np.ndarray, "directions params"]:
    """Independent steps of the scanner by one standard deviation, largest first: its covariance, and a drift."""
    names = scanner.parameter_names()
    loose = np.array([_LOOSE.get(name, _LOOSE.get(name.rsplit(".", 1)[-1], 0.0)) for name in names])
    covariance = np.diag(loose**2)
    if scanner.covariance is not None:
        covariance = covariance + np.asarray(scanner.covariance, np.float64)
    steps = root_of(covariance)[::-1][:_DIRECTIONS]
    return steps[steps.any(1)]


def bending(scanner: Scanner, cells: Cells) -> Float[np.ndarray, "points 3 directions"]:
    """Shifts of the valid cells of a grid [m] by each of the `likely_steps`."""
    laser = np.full(int(cells.valid.sum()), cells.laser, np.int32)
    by_scanner = point_gradient(scanner.rig, cells.q[cells.valid], laser, cells.phi[cells.valid])
    return (by_scanner @ likely_steps(scanner).T).astype(np.float32)


_MOST = 1500
"""Points of one fit."""


class BentPlane(NamedTuple):
    """A plane `normal . p = distance` through points as they are, and how the calibration may have bent it."""

    normal: Float[np.ndarray, "3"]
    distance: float
    centre: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "2 3"]
    likely: Float[np.ndarray, " directions"]
    """Steps of the calibration, within its covariance, that explain most of the bend."""
    rest: Float[np.ndarray, "3"]
    """How far these steps shift (at the centre [m]) and tilt (along the axes) the plane."""
    taken: Float[np.ndarray, "3 directions"]
    """Shift and tilt of the plane by each likely step alone."""
    curvature: float
    """Largest curvature of the points as they are, before the calibration is moved [1/m]."""
    curvature_sigma: float
    """Standard deviation of the curvature, by noise and by the likely steps [1/m]."""

    def error(self, p: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """Distances [n] of points [n, 3] from the bent plane; `bend` [n, 3, directions] as of `bending`."""
        shift = (bend @ self.likely) @ self.normal - self.rest[0] - (p - self.centre) @ (self.rest[1:] @ self.axes)
        return p @ self.normal - self.distance - shift


def bent_plane(
    p: Float[np.ndarray, "points 3"],
    sigma: Float[np.ndarray, " points"],
    bend: Float[np.ndarray, "points 3 directions"],
) -> BentPlane:
    """Least squares of a plane [m] and of the likely steps of the calibration, whose prior is one sigma."""
    some = spread_over(np.arange(len(p)), _MOST)
    p, bend, weight = p[some], bend[some], 1.0 / (sigma[some] ** 2 + ROUGH_M**2)
    plane = weighted_plane(p, weight)
    normal, _, centre, axes, _ = facing(plane, -plane.centre)
    apart = p - centre
    s, t = apart @ axes[0], apart @ axes[1]
    flat = np.column_stack([np.ones(len(p)), s, t])
    height = apart @ normal
    shifts = np.einsum("nik,i->nk", bend, normal)
    # The part of the shifts that is a plane itself is the plane's: a point of each region stays where it is.
    plain = np.linalg.solve((flat * weight[:, None]).T @ flat, (flat * weight[:, None]).T)
    offset, taken = plain @ height, plain @ shifts
    bent = shifts - flat @ taken
    information = (bent * weight[:, None]).T @ bent + np.eye(bent.shape[1])
    likely = np.linalg.solve(information, (bent * weight[:, None]).T @ (height - flat @ offset))
    curved = np.column_stack([flat, s * s, s * t, t * t])
    inverse = np.linalg.pinv((curved * weight[:, None]).T @ curved)
    fit = inverse @ (curved * weight[:, None]).T
    c, by_likely = fit @ height, (fit @ shifts)[3:]
    hessian = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    curvature = float(np.abs(np.linalg.eigvalsh(hessian)).max())
    doubt = 2.0 * float(np.sqrt(max(inverse[3, 3], inverse[5, 5]) + (by_likely**2).sum(1).max(initial=0.0)))
    tilted = normal - offset[1] * axes[0] - offset[2] * axes[1]
    tilted = tilted / np.linalg.norm(tilted)
    middle = centre + offset[0] * normal
    first = axes[0] - (axes[0] @ tilted) * tilted
    first = first / np.linalg.norm(first)
    second = np.cross(tilted, first)
    frame = np.stack([first, second if second @ axes[1] > 0 else -second])
    return BentPlane(tilted, float(tilted @ middle), middle, frame, likely, taken @ likely, taken, curvature, doubt)


_TURN = np.cos(np.radians(4.0))
"""Cosine of the angle between the normals of neighbours on one surface, at most."""
_SEED_M = 0.4
"""Radius of the first region around a seed [m]."""
_STEP_M = 2e-3
"""Mean distance of a neighbourhood from the plane that is allowed beside its noise [m]; steps of 5 mm are larger."""
_CURVED, _MOST_CURVED = 0.015, 0.05
"""Curvature of a flat wall beside the part that noise and calibration allow, and with that at most [1/m]."""
_BOWED_M = 1.5e-3
"""Height of the bow up to which curvature does not matter: small patches are rough [m]."""
_FACETS = 0.012
"""Angle from which two planes that pass smoothly into each other are facets of a curved surface [rad]."""
_CELLS = 40
"""Cells of a region at least."""
_NARROW_M = 0.2
"""Width of a region at least [m]."""
_ROUNDS = 12
_PART = 0.25
"""Size of a neighbour that makes a region a facet, over its own: a curtain's end does not spoil a wall."""
_REGIONS = 200
"""Regions of one grid at most."""


class Region(NamedTuple):
    """A flat part of one grid of cells."""

    grid: Cells
    cells: Int[np.ndarray, " cells"]
    """Flat indices."""
    bend: Float[np.ndarray, "valid 3 directions"]
    """Shifts of the valid cells of the grid by the likely steps of the calibration [m]."""
    place: Int[np.ndarray, " grid"]
    """Number of each cell of the grid among the valid ones."""
    plane: BentPlane
    bowed: bool


def flat_regions(cells: Cells, scanner: Scanner) -> list[Region]:
    """All flat regions of a grid, the largest first; the scanner's covariance limits how far it bends a flat wall."""
    around, bend = surroundings(cells), bending(scanner, cells)
    place = np.cumsum(cells.valid.ravel()) - 1
    part = smooth_parts(cells.p, around.normal, around.even, 4.0 * around.sigma + _STEP_M / 2, _TURN)
    names, sizes = np.unique(part[around.even], return_counts=True)
    found: list[Region] = []
    for name in names[np.argsort(-sizes)]:
        left = part == name
        own: list[Region] = []
        while left.sum() >= _CELLS and len(found) + len(own) < _REGIONS:
            region, tried = _grown(cells, around, left, bend, place)
            if region is not None:
                own.append(region)
            left &= ~tried
        found += _without_facets(around, own)
    return sorted(found, key=lambda region: -len(region.cells))


def _grown(
    cells: Cells, around: Surroundings, left: Bool[np.ndarray, "rows columns"], bend: np.ndarray, place: np.ndarray
) -> tuple[Region | None, Bool[np.ndarray, "rows columns"]]:
    """A region around the best seed, if it is flat, and the cells that need not be tried again."""
    from scipy.ndimage import label  # type: ignore[import-untyped]

    members = np.flatnonzero(left.ravel())
    p, sigma = cells.p.reshape(-1, 3), around.sigma.ravel()
    seed = _seed(around, left)
    region = members[np.linalg.norm(p[members] - p[seed], axis=1) < _SEED_M]
    tried = np.zeros_like(left)
    tried.ravel()[region] = True
    if len(region) < _CELLS:
        return None, tried
    for _ in range(_ROUNDS):
        plane = bent_plane(p[region], sigma[region], bend[place[region]])
        fits = np.zeros(left.size, bool)
        fits[members] = _fits(around, left, members, plane.error(p[members], bend[place[members]]))
        part = label(fits.reshape(left.shape))[0].ravel()
        now = np.flatnonzero(fits & (part == part[seed]))
        if len(now) < _CELLS:
            return None, tried
        same = np.array_equal(now, region)
        region = now
        if same:
            break
    else:
        plane = bent_plane(p[region], sigma[region], bend[place[region]])
    tried.ravel()[region] = True
    extent = np.ptp((p[region] - plane.centre) @ plane.axes.T, axis=0)
    limit = min(_CURVED + 3.0 * plane.curvature_sigma, _MOST_CURVED)
    bowed = plane.curvature > limit and plane.curvature * extent.max() ** 2 / 8 > _BOWED_M
    if extent.min() < _NARROW_M:
        return None, tried
    return Region(cells, region, bend, place, plane, bowed), tried


def _without_facets(around: Surroundings, regions: list[Region]) -> list[Region]:
    """Regions of one smooth part of the grid, without those that pass into another one at an angle."""
    near = []
    for region in regions if len(regions) > 1 else ():
        mask = np.zeros(around.even.shape)
        mask.ravel()[region.cells] = 1.0
        near.append(around.windows.sums(mask) > 0)
    facets = {k for k, region in enumerate(regions) if region.bowed}
    for i in range(len(near)):
        for j in range(len(near)):
            a, b = regions[i], regions[j]
            if i == j or len(b.cells) < _PART * len(a.cells) or not (near[i] & near[j]).any():
                continue
            tilt = a.plane.axes.T @ a.plane.taken[1:] - b.plane.axes.T @ b.plane.taken[1:]
            doubt = 3.0 * float(np.sqrt((tilt**2).sum(1).max(initial=0.0)))
            if b.bowed or np.linalg.norm(a.plane.normal - b.plane.normal) > _FACETS + doubt:
                facets.add(i)
    return [region for k, region in enumerate(regions) if k not in facets]


def _seed(around: Surroundings, left: Bool[np.ndarray, "rows columns"]) -> int:
    """The cell deepest within the rest: with the fullest neighbourhood, then the least scatter."""
    share = around.windows.sums(left.astype(np.float64)) / around.windows.area()
    rank = np.where(left, share - 0.1 * around.scatter / np.maximum(around.sigma, 1e-6), -np.inf)
    return int(np.argmax(rank))


def _fits(around: Surroundings, left: np.ndarray, members: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Which members lie on the plane, by the mean error of their neighbourhoods and by their own."""
    grid = np.zeros(left.size)
    grid[members] = error
    count = np.maximum(around.windows.sums(left.astype(np.float64)).ravel()[members], 1.0)
    mean = around.windows.sums(grid.reshape(left.shape)).ravel()[members] / count
    sigma = around.sigma.ravel()[members]
    return (np.abs(mean) < _STEP_M + 3.0 * sigma / np.sqrt(count)) & (np.abs(error) < 4.0 * sigma + 2.0 * _STEP_M)
