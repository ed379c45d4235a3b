"""The large planes of a room, by RANSAC with hypotheses from small patches."""

import numpy as np

from jaxscan.geometry import principal_axes
from jaxscan.measurement.planes import Plane, weighted_plane
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
