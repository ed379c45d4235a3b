"""A frame for a cloud: that of known targets, or of the room itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.errors import MeasurementError
from jaxscan.geometry import nearest_rotation
from jaxscan.measurement.room import because, bounding_walls
from jaxscan.measurement.samples import Cloud, CloudSamples
from jaxscan.measurement.walls import Wall


FEWEST_TARGETS = 3
_NARROW = 0.02
"""Least extent of the targets across the line on which they nearly lie, in extents along it."""
_SCALES = (0.9, 1.1)
"""Ratios of the distances in both frames that can be errors of measurement."""
_MIRRORED = 5.0
"""Targets are mirrored if they leave their plane by this many residuals, to the wrong side."""
_LEAST_M, _OFF = 0.002, 10.0
"""One target is off if it is this many standard deviations of the others from its place, of at least this size [m]."""
_MISFIT_M, _MISFIT = 0.03, 0.01
"""Largest standard deviation of a target's coordinate [m], and what is added to it per metre from their middle [1]."""
_UPRIGHT = 0.9
"""Least cosine between the floor's normal and the scanner's z."""


@dataclass(frozen=True)
class TargetFrame:
    """The frame in which the targets have their known coordinates, T_site_scanner [4, 4]."""

    transform: np.ndarray
    residuals_m: np.ndarray
    """Known coordinates less those that the cloud has now [targets, 3]."""
    sigma_m: float
    """Standard deviation of a coordinate of a target, in both frames together, as the residuals show it."""
    freedom: int
    """Redundancy: residuals less unknowns; 3 for three targets."""
    scale: float
    """Ratio of distances between targets, site to scanner [1]; the frame does not use it."""
    centre_m: np.ndarray
    covariance: np.ndarray
    """Covariance of a step (translation of the middle [m], rotation about it [rad]), site frame [6, 6]."""

    def sigma_at(self, place: Float[np.ndarray, "3"]) -> float:
        """Standard deviation by which the frame places a point [m], all directions together; no noise of the point."""
        x, y, z = np.asarray(place, np.float64) - self.centre_m
        step = np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
        return float(np.sqrt(np.trace(step @ self.covariance @ step.T)))


@dataclass(frozen=True)
class RoomFrame:
    """The frame of a room, T_room_scanner: the floor is z = 0, x along the longer wall, the origin in a corner."""

    transform: np.ndarray
    sigma_m: np.ndarray
    """Standard deviation of the origin along x, y, z [3], from the noise of the points alone."""
    wall_rms_m: np.ndarray
    """RMS distance of the points from the cross wall (x), the longer wall (y) and the floor (z) [3]."""
    corner_deg: float
    """Angle between the two walls; only the longer one is parallel to an axis."""
    tilt_deg: float


def align_targets(
    scanner: Float[np.ndarray, "targets 3"], site: Float[np.ndarray, "targets 3"], *, names: Sequence[str] | None = None
) -> TargetFrame:
    r"""The rigid motion that brings targets nearest to their known coordinates.

    Minimises $\sum_i |R a_i + t - b_i|^2$ over rotations R, in closed form; lengths stay as they are. With f residuals
    to spare, standard deviations are $\sqrt{f / (f - 2)}$ times those of known noise (Student's distribution).

    Args:
        scanner: Targets in the frame of the cloud [m], three or more that are not on one line.
        site: The same targets in the frame that is wanted [m].
        names: Names of the targets; by default their numbers from 1.

    Returns:
        The frame, the residuals, and their standard deviations.

    Raises:
        MeasurementError: If the targets are too few, nearly on one line, mirrored, in another unit, or contradict each
            other; with the name of the one that is off where the others tell.

    Source: Kabsch, A solution for the best rotation to relate two sets of vectors (1976).
    """
    a, b = np.asarray(scanner, np.float64), np.asarray(site, np.float64)
    names = [str(number + 1) for number in range(len(a))] if names is None else list(names)
    try:
        found = _fitted(a, b)
    except MeasurementError:
        # One wrong target can look like another unit or a mirror.
        _check_each(a, b, names)
        raise
    _check_each(a, b, names)
    reach = float(np.sqrt(np.mean(np.sum((b - found.centre_m) ** 2, axis=1))))
    if found.sigma_m > _MISFIT_M + _MISFIT * reach:
        off = np.linalg.norm(found.residuals_m, axis=1)
        which = (
            "Three do not tell which of them is wrong: give a fourth, or measure them again."
            if len(a) == FEWEST_TARGETS
            else "No single one explains it: two may be exchanged, or several are wrong."
        )
        raise MeasurementError(
            f"The targets contradict each other: residuals up to {1e3 * off.max():.0f} mm, at target "
            f"{names[int(np.argmax(off))]!r}, expected less than {1e3 * (_MISFIT_M + _MISFIT * reach):.0f} mm. {which}"
        )
    return found


def _check_each(a: np.ndarray, b: np.ndarray, names: list[str]) -> None:
    """Refuse a target that is off where all others agree without it."""
    if len(a) <= FEWEST_TARGETS:
        return
    alone: list[tuple[float, float, str]] = []
    for number, name in enumerate(names):
        others = np.arange(len(a)) != number
        try:
            found = _fitted(a[others], b[others])
        except MeasurementError:
            continue
        sigma = max(found.sigma_m, _LEAST_M)
        placed = found.transform[:3, :3] @ a[number] + found.transform[:3, 3]
        off = float(np.linalg.norm(b[number] - placed))
        if off > _OFF * np.hypot(sigma, found.sigma_at(placed)):
            alone.append((found.sigma_m, off, name))
    if alone:
        sigma, off, name = min(alone)
        raise MeasurementError(
            f"Target {name!r} is {1e3 * off:.0f} mm from where the others place it, which agree to {1e3 * sigma:.1f} "
            f"mm without it; expected less than {_OFF:g} standard deviations: correct its coordinates or leave it out."
        )


def _fitted(scanner: np.ndarray, site: np.ndarray) -> TargetFrame:
    """The frame of targets, whether or not they agree."""
    a, b = scanner, site
    count = len(a)
    if count < FEWEST_TARGETS:
        raise MeasurementError(
            f"{count} targets, expected {FEWEST_TARGETS} or more: fewer do not determine a rotation."
        )
    middle_a, middle_b = a.mean(0), b.mean(0)
    a, b = a - middle_a, b - middle_b
    for name, points in (("the scanner's", a), ("the site's", b)):
        along, across, _ = np.linalg.svd(points, compute_uv=False)
        if not across > _NARROW * along:
            raise MeasurementError(
                f"The targets lie on one line in {name} coordinates, to {1e3 * across / np.sqrt(count):.0f} mm; "
                "expected one far beside it: they do not tell the turn about the line."
            )
    scale = float(np.sqrt((b**2).sum() / (a**2).sum()))
    if not _SCALES[0] < scale < _SCALES[1]:
        raise MeasurementError(
            f"Distances between the targets are {scale:.4g} times as long on the site as in the cloud, expected the "
            "same: both in metres, and every target with its own coordinates."
        )
    u, size, v = np.linalg.svd(b.T @ a)
    mirrored, mirrored_rms = np.linalg.det(u @ v) < 0, np.sqrt(np.mean((a @ (u @ v).T - b) ** 2))
    if mirrored and np.sqrt(size[2] / count) > _MIRRORED * mirrored_rms + 1e-6 * np.sqrt(size[0] / count):
        raise MeasurementError(
            f"The targets fit as their mirror image only, to {1e3 * mirrored_rms:.1f} mm; expected right-handed "
            "coordinates in both frames: two axes may be exchanged, or one counts the other way."
        )
    turn = nearest_rotation(b.T @ a)
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn, middle_b - turn @ middle_a
    placed = a @ turn.T
    residuals = b - placed
    freedom = 3 * count - 6
    sigma = float(np.sqrt((residuals**2).sum() / freedom))
    information = np.zeros((6, 6))
    information[:3, :3] = count * np.eye(3)
    information[3:, 3:] = (placed**2).sum() * np.eye(3) - placed.T @ placed
    covariance = sigma**2 * freedom / (freedom - 2) * np.linalg.inv(information)
    return TargetFrame(transform, residuals, sigma, freedom, scale, middle_b, covariance)


def align_room(cloud: Cloud, *, seed: int = 0) -> RoomFrame:
    """The frame of a room's floor and two of its walls.

    The room is at positive x, and at positive y too if the walls of that corner were seen.

    Args:
        cloud: The room, scanned from within; z of the scanner frame is vertical within 10 degrees.
        seed: Seed of the random hypotheses; the result is deterministic.

    Returns:
        The frame, its standard deviations, and how flat and how square the room is.

    Raises:
        MeasurementError: If floor or walls are not found.
    """
    pairs, planes, remarks = bounding_walls(CloudSamples(cloud), np.random.default_rng(seed), seed=seed)
    *across, level = pairs
    floors = [wall for wall in level if -wall.plane.normal[2] > _UPRIGHT]
    if not floors or len(across) < 2 or not all(across):
        seen = sum(map(len, across))
        raise MeasurementError(
            f"{len(floors)} floors and {seen} walls among {planes} planes, expected the floor and two walls that meet"
            f"{because(remarks)}; a room must be scanned from within, in steps of a few degrees."
        )
    (floor,) = floors
    up = -floor.plane.normal
    long = int(np.argmax([_longest(across[k], across[1 - k], up) for k in (0, 1)]))
    # A corner from which the room is at positive y is preferred, then one at the longest wall.
    corners = [(wall, other) for wall in across[long] for other in across[1 - long]]
    ahead = [-wall.plane.normal @ _axes(wall, other, up)[1] > 0 for wall, other in corners]
    best = max(range(len(corners)), key=lambda k: (ahead[k], _length(corners[k][0], up)))
    wall, other = corners[best]
    axes, sides = _axes(wall, other, up), (other, wall, floor)
    origin = np.linalg.solve([side.plane.normal for side in sides], [side.plane.distance for side in sides])
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = axes, -axes @ origin
    cosines = np.clip([-wall.plane.normal @ -other.plane.normal, up[2]], -1.0, 1.0)
    corner, tilt = np.degrees(np.arccos(cosines))
    return RoomFrame(
        transform=transform,
        sigma_m=np.array([side.plane.sigma_at(origin) for side in sides]),
        wall_rms_m=np.array([side.rms_m for side in sides]),
        corner_deg=float(corner),
        tilt_deg=float(tilt),
    )


def _axes(wall: Wall, other: Wall, up: np.ndarray) -> np.ndarray:
    """x along a wall and away from the other one, y, z: the rows of a rotation [3, 3]."""
    along = np.cross(up, wall.plane.normal)
    along *= -np.sign(along @ other.plane.normal) / np.linalg.norm(along)
    return np.stack([along, np.cross(up, along), up])


def _longest(walls: list[Wall], cross: list[Wall], up: np.ndarray) -> float:
    """Length of the walls between those across, or of the points on them where one of those was not seen [m]."""
    if len(cross) == 2:
        first, second = (wall.plane for wall in cross)
        return float((first.centre - second.centre) @ first.normal)
    return max(_length(wall, up) for wall in walls)


def _length(wall: Wall, up: np.ndarray) -> float:
    """Horizontal extent of a wall's points, without the last 0.5 % on either side [m]."""
    low, high = np.percentile(wall.samples.p @ np.cross(up, wall.plane.normal), [0.5, 99.5])
    return float(high - low)
