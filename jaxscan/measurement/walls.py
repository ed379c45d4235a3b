"""The walls of a room: large planes by RANSAC, with hypotheses from small patches, refined on all their points."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import median_sigma, principal_axes
from jaxscan.measurement.planes import Plane, facing, fitted_plane, weighted_plane
from jaxscan.measurement.samples import CloudSamples, Samples, spread_out


VOTERS = 12000
HYPOTHESES = 500
PATCH_M = 0.3
"""Radius of the patch behind one hypothesis [m]."""
MIN_PROFILES = 3
"""Smallest number of profiles in a patch: a sheet is a plane itself, so the points of one profile,
or of two opposite ones, lie on a plane in any case."""
GROWN = 8
"""Number of best hypotheses per round that are refitted to their inliers before one is chosen."""
MIN_SHARE = 0.008
"""Smallest share of all points on a plane."""
MAX_PLANES = 24
NEAREST_M, FARTHEST_M = 0.004, 0.02
"""Limits of the distance from a plane up to which a point votes for it (3 sigma between) [m]."""


def find_planes(samples: CloudSamples, *, seed: int) -> list[tuple[Plane, np.ndarray]]:
    """Planes with their supporting points [k, 3], most supported first; the same for the same seed."""
    rng = np.random.default_rng(seed)
    voters = samples.take(spread_out(len(samples), VOTERS, rng))
    normals, distances, origin = _hypotheses(voters, rng)
    left = np.ones(len(voters.p), bool)
    planes: list[tuple[Plane, np.ndarray]] = []
    while len(planes) < MAX_PLANES and len(normals) > 0:
        votes = _votes(voters, left, normals, distances)
        best: tuple[int, Plane, np.ndarray] | None = None
        for k in np.argsort(-votes, kind="stable")[:GROWN]:
            grown = _grow(voters, left, normals[k], distances[k])
            if grown is not None and (best is None or grown[1].sum() > best[0]):
                best = (int(grown[1].sum()), *grown)
        if best is None or best[0] < max(MIN_SHARE * len(voters.p), 20):
            break
        planes.append((best[1], voters.p[best[2]]))
        left &= ~best[2]
        # A hypothesis is dropped once the point that it was built around is used.
        alive = left[origin]
        normals, distances, origin = normals[alive], distances[alive], origin[alive]
    return planes


def _hypotheses(voters: Samples, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # Imported here, so that `import jaxscan` does not load SciPy.
    from scipy.spatial import cKDTree  # type: ignore[import-untyped]

    origin = spread_out(len(voters.p), HYPOTHESES, rng)
    groups = cKDTree(voters.p).query_ball_point(voters.p[origin], PATCH_M)
    # Clouds of other programs have no profiles.
    profiles = min(MIN_PROFILES, len(np.unique(voters.profile)))
    normals, distances, kept = [], [], []
    for seed_point, group in zip(origin, groups, strict=True):
        if len(group) < 6 or len(np.unique(voters.profile[group])) < profiles:
            continue
        plane = principal_axes(voters.p[group])
        normals.append(plane.axes[0])
        distances.append(plane.axes[0] @ plane.centre)
        kept.append(seed_point)
    return np.array(normals).reshape(-1, 3), np.array(distances), np.array(kept, int)


def _votes(voters: Samples, left: np.ndarray, normals: np.ndarray, distances: np.ndarray) -> np.ndarray:
    # Single precision and one matrix product: the only step that touches points x hypotheses.
    p = voters.p[left].astype(np.float32)
    band = np.clip(3.0 * voters.sigma[left], NEAREST_M, FARTHEST_M).astype(np.float32)
    away = np.abs(p @ normals.T.astype(np.float32) - distances.astype(np.float32))
    return np.count_nonzero(away < band[:, None], axis=0)


def _grow(voters: Samples, left: np.ndarray, normal: np.ndarray, distance: float) -> tuple[Plane, np.ndarray] | None:
    """Refit a hypothesis to its own inliers until they stay the same."""
    inliers = np.zeros(len(left), bool)
    plane: Plane | None = None
    for _ in range(12):
        sigma = voters.sigma_across(normal)
        band = np.clip(3.0 * sigma, NEAREST_M, FARTHEST_M)
        found = left & (np.abs(voters.p @ normal - distance) < band)
        if found.sum() < 6:
            return None
        if plane is not None and np.array_equal(found, inliers):
            break
        inliers = found
        plane = weighted_plane(voters.p[inliers], sigma[inliers] ** -2)
        normal, distance = plane.normal, plane.distance
    return None if plane is None else (plane, inliers)


REFINED = 200_000
"""Largest number of points in the refinement of a wall."""
NEIGHBOURHOOD_M = 0.05
"""Points within this distance and 6 sigma of the plane take part in its refinement [m]."""
KEPT = 2.5
"""Residuals beyond this many (robust) standard deviations are left out, on both sides alike."""
FEWEST = 4
"""Points in the refinement of a wall, at least: three lie on any plane."""
SHARE, SPAN = 0.1, 0.5
"""A wall has at least these shares of the largest support and of the largest width of all planes on
its side of the room; smaller planes are things behind a door."""
NARROW = 0.05
"""A wall is at least this wide across its longest extent, in units of it: points of one line lie on any plane."""
BEYOND, BEYOND_M = 0.2, 0.1
"""At most this share of all points is farther than this [m] behind a wall, seen through its openings; with more the
room goes on behind it."""
SYSTEMATIC_POINTS = 2000
"""Points per wall on which the effect of the calibration is evaluated."""


class Wall(NamedTuple):
    """A bounding plane of the room, its normal pointing out of the room."""

    plane: Plane
    samples: Samples
    scale: float
    """Robust standard deviation of the residuals in units of the predicted one [1]."""

    def moved(self, step: np.ndarray) -> "Wall":
        """The wall after a shift [3], m."""
        plane = self.plane
        distance = float(plane.distance + plane.normal @ step)
        plane = plane._replace(distance=distance, centre=plane.centre + step)
        return self._replace(plane=plane, samples=self.samples.moved(step))

    def behind(self, samples: CloudSamples | Samples) -> float:
        """Share of the points that are behind it [1]; above `BEYOND` it does not bound them."""
        normal, distance = self.plane.normal, self.plane.distance
        blocks = samples.blocks() if isinstance(samples, CloudSamples) else [samples]
        beyond = [some.p @ normal - distance > BEYOND_M + 6.0 * some.sigma for some in blocks]
        return float(sum(map(np.count_nonzero, beyond)) / sum(map(len, beyond)))

    @property
    def rms_m(self) -> float:
        """RMS distance of its points [m]."""
        residual = self.samples.p @ self.plane.normal - self.plane.distance
        return float(np.sqrt(np.mean(residual**2)))


def outermost(candidates: list[tuple[Plane, np.ndarray]], outward: np.ndarray) -> Plane | None:
    """The outermost large plane on the side `outward` (unit [3]) of the room, or None.

    Furniture in front of a wall may have more points than the wall.
    """
    side = [(facing(plane, outward), p) for plane, p in candidates]
    side = [
        (plane, p)
        for plane, p in side
        if plane.distance > 0 and np.min(widths := _widths(plane, p)) >= NARROW * np.max(widths)
    ]
    if not side:
        return None
    support = np.array([len(p) for _, p in side])
    width = np.array([np.max(_widths(plane, p)) for plane, p in side])
    large = (support >= SHARE * support.max()) & (width >= SPAN * width[support >= SHARE * support.max()].max())
    depth = np.array([plane.distance if big else -np.inf for (plane, _), big in zip(side, large, strict=True)])
    return side[int(np.argmax(depth))][0]


def _widths(plane: Plane, p: np.ndarray) -> np.ndarray:
    """Extents of the support along the axes of its plane [2], without its last 2 % on either side [m]."""
    low, high = np.percentile((p - plane.centre) @ plane.axes.T, [2, 98], axis=0)
    return np.asarray(high - low)


def refine_wall(samples: CloudSamples | Samples, plane: Plane, *, rng: np.random.Generator) -> Wall:
    """Weighted least squares on the wall's points alone.

    Skirting, pictures and furniture are in front of a wall, and nothing is behind it. So the scale
    of the residuals is estimated from the outer side, and both tails are cut at the same distance:
    things in front do not shift the plane.
    """
    normal, distance = plane.normal, plane.distance

    def is_near(some: Samples) -> np.ndarray:
        residual = some.p @ normal - distance
        return np.asarray(np.abs(residual) < NEIGHBOURHOOD_M + 6.0 * some.sigma_across(normal))

    near = samples.chosen(is_near) if isinstance(samples, CloudSamples) else np.flatnonzero(is_near(samples))
    near = near[spread_out(len(near), REFINED, rng)]
    around = samples.take(near)
    kept, scale = np.ones(len(near), bool), 1.0
    for _ in range(30):
        sigma = around.sigma_across(normal)
        residual = (around.p @ normal - distance) / sigma
        scale = _outer_scale(residual)
        now = np.abs(residual) <= KEPT * scale
        # If the points contradict the plane, none may be left.
        if np.array_equal(now, kept) or np.count_nonzero(now) < FEWEST:
            break
        kept = now
        plane = facing(weighted_plane(around.p[kept], around.weights_across(normal)[kept]), normal)
        normal, distance = plane.normal, plane.distance
    members = around.take(kept)
    return Wall(facing(fitted_plane(members, normal), normal), members, scale)


def wall_weights(wall: Wall, row: np.ndarray, rng: np.random.Generator | None = None) -> tuple[Samples, np.ndarray]:
    """Weights of some of a wall's points in numbers that depend on its plane.

    With weights `row` [(k,) 3] of the plane's (offset, slopes), numbers move by sum w . dp, w [(k,) n, 3].
    """
    rng = np.random.default_rng(0) if rng is None else rng
    part = wall.samples.take(spread_out(len(wall.samples.p), SYSTEMATIC_POINTS, rng))
    plane = wall.plane
    weight = part.weights_across(plane.normal)
    design = np.column_stack([np.ones(len(part.p)), (part.p - plane.centre) @ plane.axes.T])
    normal_equations = (design * weight[:, None]).T @ design
    factors = np.linalg.solve(normal_equations, row.T).T @ (design * weight[:, None]).T
    return part, factors[..., None] * plane.normal


def _outer_scale(residual: np.ndarray) -> float:
    outer = residual[(residual > 0) & (residual < 8.0)]
    if len(outer) < 10:
        return 3.0
    return float(np.clip(median_sigma(outer), 0.5, 4.0))
