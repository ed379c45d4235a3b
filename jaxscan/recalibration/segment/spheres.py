"""A known sphere in the cloud of a sweep."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.measurement.spheres import spheres_through
from jaxscan.recalibration.observed import SurfacePoints, SweepStripes
from jaxscan.recalibration.segment.surfaces import far_apart
from jaxscan.recalibration.triangulate import triangulate_points


_AROUND_M = 0.25
"""How far a sphere may be from the place that was given for it [m]."""
_COARSE = 400
"""Profiles and lines of the first look at most."""
_MOST = 60_000
"""Stripes that are looked at."""
_TRIES = 2000
_NEAR_M = 4e-3
"""Distance from the sphere up to which a point speaks for it [m]."""
_GRAZING = 0.45
"""Cosine of the angle between ray and sphere from which its points are used: its rim rounds."""
_FEWEST = 30
_SHARE = 0.15
"""Share of the part of a sphere that faces the scanner, in spots of a tenth of its diameter, that must be seen."""
_KEPT = 3.5
_SIZE = 0.04
"""By how much the diameter may differ from the one that was given: calibrations are nearer [1]."""


class Sphere(NamedTuple):
    """A sphere that was found, in the frame of its scanner."""

    centre: Float[np.ndarray, "3"]
    """[m]."""
    radius: float
    """As it was given [m]."""
    points: SurfacePoints
    """On it, their sweep and surface both 0."""


def find_sphere(sweep: SweepStripes, scanner: Scanner, near: Float[np.ndarray, "3"], diameter_m: float) -> Sphere:
    """The sphere of known diameter near a place.

    Args:
        sweep: The stripes, known faults of the angles corrected.
        scanner: The calibrated rig.
        near: Its middle to 0.25 m, in the scanner's frame [m].
        diameter_m: Its diameter [m].

    Raises:
        CalibrationError: If there is no such sphere.
    """
    near, radius = np.asarray(near, np.float64), diameter_m / 2
    profile, line = _around(sweep, scanner, near, _AROUND_M + diameter_m)
    p, sigma = _points(sweep, scanner, profile, line)
    centre = _best(p, near, radius)
    found = "none"
    if centre is not None:
        for _ in range(8):
            centre, kept = _refined(p, sigma, centre, radius)
        if kept.sum() >= _FEWEST and _seen(p[kept], centre, radius) >= _SHARE:
            size = 2 * _own_radius(p, centre, radius)
            found = f"one of {1e3 * size:.0f} mm" if abs(size / diameter_m - 1) > _SIZE else ""
    if centre is None or found:
        place = ", ".join(f"{x:.2f}" for x in near)
        raise CalibrationError(
            f"{sweep.name}: found {found}, expected a sphere of {1e3 * diameter_m:.0f} mm within {_AROUND_M} "
            f"m of ({place}) m: measure its place and diameter again, or leave it out"
        )
    chosen = np.flatnonzero(kept)
    shared = np.maximum(sweep.shared_lines[profile, line].astype(np.float64), 1.0)[chosen]
    chosen = chosen[far_apart(np.zeros(len(chosen), int), profile[chosen], line[chosen], shared)]
    profile, line = profile[chosen], line[chosen]
    zero = np.zeros(len(chosen), int)
    points = SurfacePoints(
        sweep.pixels(profile, line),
        sweep.sigma[profile, line].astype(np.float64),
        zero,
        sweep.record[profile],
        line,
        sweep.laser[profile],
        zero,
    )
    return Sphere(centre, radius, points)


def _points(
    sweep: SweepStripes, scanner: Scanner, profile: np.ndarray, line: np.ndarray
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"]]:
    """Points and their standard deviations along the ray [m]; points that do not exist are far away."""
    q, laser, phi = sweep.pixels(profile, line), sweep.laser[profile], sweep.angle[sweep.record[profile]]
    p, exists = triangulate_points(scanner, q, laser, phi)
    beside = q + (np.array([0.25, 0.0]) if sweep.stripe_axis == "rows" else np.array([0.0, 0.25]))
    moved, _ = triangulate_points(scanner, beside, laser, phi)
    slope = np.linalg.norm(moved - p, axis=1) / 0.25
    p[~exists] = 1e3
    return p, slope * sweep.sigma[profile, line]


def _around(
    sweep: SweepStripes, scanner: Scanner, near: np.ndarray, reach: float
) -> tuple[Int[np.ndarray, " stripes"], Int[np.ndarray, " stripes"]]:
    """Profiles and lines of the stripes within reach of a place, thinned where there are too many."""
    steps = [-(-size // _COARSE) for size in sweep.valid.shape]
    coarse = np.zeros(sweep.valid.shape, bool)
    coarse[:: steps[0], :: steps[1]] = True
    profile, line = np.nonzero(sweep.valid & coarse)
    p, _ = triangulate_points(
        scanner, sweep.pixels(profile, line), sweep.laser[profile], sweep.angle[sweep.record[profile]]
    )
    close = np.linalg.norm(p - near, axis=1) < reach
    blocks = np.zeros([size // step + 1 for size, step in zip(sweep.valid.shape, steps, strict=True)], bool)
    blocks[profile[close] // steps[0], line[close] // steps[1]] = True
    all_of = np.repeat(np.repeat(blocks, steps[0], 0), steps[1], 1)[: sweep.valid.shape[0], : sweep.valid.shape[1]]
    profile, line = np.nonzero(all_of & sweep.valid)
    some = slice(None, None, max(1, -(-len(profile) // _MOST)))
    return profile[some], line[some]


def _best(p: np.ndarray, near: np.ndarray, radius: float) -> np.ndarray | None:
    """The centre for which most points speak, of those of the sphere through three points."""
    rng = np.random.default_rng(0)
    p = p[np.linalg.norm(p - near, axis=1) < _AROUND_M + 2 * radius]
    if len(p) < _FEWEST:
        return None
    first = rng.integers(0, len(p), _TRIES)
    # Three points of one small neighbourhood lie on the sphere more often than any three.
    voters = p[rng.choice(len(p), min(len(p), 3000), replace=False)]
    beside = voters[rng.integers(0, len(voters), (_TRIES, 24))]
    far = np.linalg.norm(beside - p[first][:, None], axis=-1)
    close = np.argsort(np.where((far > 0.2 * radius) & (far < 1.6 * radius), 0.0, 1.0), axis=1, kind="stable")[:, :2]
    a, b, c = p[first], *(np.take_along_axis(beside, close[:, k, None, None], 1)[:, 0] for k in (0, 1))
    centre, good = spheres_through(a, b, c, radius, away=a)
    good &= np.linalg.norm(centre - near, axis=1) < _AROUND_M
    if not good.any():
        return None
    centre = centre[good]
    votes = [np.count_nonzero(np.abs(np.linalg.norm(voters - one, axis=1) - radius) < _NEAR_M) for one in centre]
    return centre[int(np.argmax(votes))]


def _look(p: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance of points from a sphere's centre [m], their directions from there, and the cosines at which the rays
    to them meet it."""
    away = p - centre
    length = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    out = away / length[:, None]
    return length, out, -(out * p).sum(1) / np.maximum(np.linalg.norm(p, axis=1), 1e-9)


def _refined(
    p: np.ndarray, sigma: np.ndarray, centre: np.ndarray, radius: float
) -> tuple[Float[np.ndarray, "3"], np.ndarray]:
    """One step of least squares, and the points that lie on the sphere and face the scanner."""
    length, out, facing = _look(p, centre)
    error, noise = length - radius, np.hypot(sigma * facing, 5e-4)
    kept = (facing > _GRAZING) & (np.abs(error) < np.maximum(_KEPT * noise, _NEAR_M / 2))
    if kept.sum() < _FEWEST:
        return centre, kept
    weight = 1.0 / noise[kept] ** 2
    normal = (out[kept] * weight[:, None]).T @ out[kept]
    return centre + np.linalg.solve(normal, (out[kept] * weight[:, None]).T @ error[kept]), kept


def _seen(p: np.ndarray, centre: np.ndarray, radius: float) -> float:
    """Share of the half of the sphere that faces the scanner with points on it."""
    spots = len(np.unique(np.round((p - centre) / (0.2 * radius)).astype(int), axis=0))
    return spots / (2 * np.pi / 0.04)


def _own_radius(p: np.ndarray, centre: np.ndarray, radius: float) -> float:
    """The radius of the sphere through the points about there [m], without knowing it."""
    from scipy.optimize import least_squares  # type: ignore[import-untyped]

    length, _, facing = _look(p, centre)
    p = p[(facing > _GRAZING) & (np.abs(length - radius) < 0.15 * radius)]
    from_sphere = lambda x: np.linalg.norm(p - x[:3], axis=1) - x[3]
    # Points behind the sphere do not count.
    found = least_squares(from_sphere, [*centre, radius], loss="cauchy", f_scale=0.03 * radius)
    return float(found.x[3])
