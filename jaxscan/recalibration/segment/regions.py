"""Flat regions of the grid: neighbours that agree, grown over all that lies on one plane."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, root_of
from jaxscan.measurement.planes import facing, weighted_plane
from jaxscan.measurement.systematic import point_gradient
from jaxscan.recalibration.grid import smooth_parts, spread_over
from jaxscan.recalibration.segment.cells import ROUGH_M, Cells, Surroundings, surroundings


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
    """The same of each likely step by itself."""
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
    """All flat regions of a grid, the largest first; the scanner's covariance says how far it may bend a flat wall."""
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
    cells: Cells,
    around: Surroundings,
    left: Bool[np.ndarray, "rows columns"],
    bend: np.ndarray,
    place: np.ndarray,
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
