"""The surface between the stripes: samples of it, as close together as a picture needs them. Neighbours of the grid
that lie on one surface are joined. If a surface ends between two profiles, it is unknown where.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import CloudError
from jaxscan.geometry import Scanner
from jaxscan.photographs.photograph import poses
from jaxscan.reconstruction import PointCloud


STEEPEST = 5.0
"""Depth change per distance across the ray up to which neighbours count as one surface."""
_WIDEST_STEP = 0.2
"""Profiles further apart [rad] are no neighbours."""


class SurfaceSamples(NamedTuple):
    """Samples of a surface; `n` of them."""

    xyz: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Zero where there is none."""
    rgb: Float[np.ndarray, "n 3"]


class _Profile(NamedTuple):
    """Points of one profile, seen from the middle of the rig."""

    xyz: np.ndarray
    normals: np.ndarray
    rgb: np.ndarray
    valid: np.ndarray
    pose: np.ndarray


def check_grid(cloud: PointCloud) -> None:
    """Refuse a cloud whose points have no neighbours.

    Raises:
        CloudError: If it has no grid [profile, line], or is not in the frame of its scanner.
    """
    if cloud.stations is not None:
        raise CloudError("the cloud was moved or is joined; photographs belong to the cloud in its scanner frame.")
    if min(np.shape(cloud.valid)) < 2 or len(np.unique(np.asarray(cloud.angle))) < 2:
        raise CloudError(
            f"the cloud has no grid of profiles and lines (found {np.shape(cloud.valid)[0]} profile); "
            "take one that `jaxscan reconstruct` wrote."
        )


def surface_samples(
    cloud: PointCloud, scanner: Scanner, spacing: float, *, reach: float = 0.5
) -> Iterator[SurfaceSamples]:
    """Samples of the surface of an organised cloud in the scanner frame, profile by profile.

    Args:
        cloud: On its grid.
        scanner: The rig that took it.
        spacing: Largest angle between neighbouring samples on one surface [rad], as seen from the rig.
        reach: How far beyond its last profile a surface reaches, as a share of the way to the next one: 1 for all
            places where it may be, 0.5 where it is most likely.

    Raises:
        CloudError: If the cloud has no grid.
    """
    check_grid(cloud)
    for profiles in _groups(cloud):
        angles = np.asarray(cloud.angle)[profiles]
        where = poses(scanner, angles)
        middle = where[:, :3, 3].mean(0)
        valid = np.asarray(cloud.valid)[profiles]
        step, line_step = _steps(np.asarray(cloud.xyz)[profiles] - middle.astype(np.float32), valid)
        skip, skip_lines = max(1, round(spacing / step)), max(1, round(spacing / line_step))

        def profile(number: int, profiles=profiles, where=where, skip_lines=skip_lines) -> _Profile:
            row = profiles[number]
            fields = (cloud.xyz, cloud.normals, cloud.rgb, cloud.valid)
            xyz, normals, rgb, valid = (np.asarray(field[row])[::skip_lines] for field in fields)
            return _Profile(xyz, normals, rgb, valid, where[number])

        chosen = list(range(0, len(profiles), skip))
        if _closes(where, step * skip, chosen):
            chosen.append(chosen[0])
        parts = max(1, int(np.ceil(step * skip / spacing)))
        before = profile(chosen[0])
        for number in chosen[1:]:
            after = profile(number)
            yield _between(before, after, middle, parts, reach)
            before = after
        yield _between(before, before, middle, 1, reach)


def _groups(cloud: PointCloud) -> Iterator[np.ndarray]:
    """Profiles that are neighbours: of one laser, in the order of their angle; one of each record at most."""
    laser, record, angle = (np.asarray(field) for field in (cloud.laser, cloud.record, cloud.angle))
    for one in np.unique(laser):
        profiles = np.flatnonzero(laser == one)
        _, first = np.unique(record[profiles], return_index=True)
        profiles = profiles[np.sort(first)]
        if len(profiles) > 1:
            yield profiles[np.argsort(angle[profiles], kind="stable")]


def _steps(way: np.ndarray, valid: np.ndarray) -> tuple[float, float]:
    """Usual angles between neighbouring profiles, and between neighbouring lines [rad]."""
    away = np.linalg.norm(way, axis=-1, keepdims=True)
    ray = way / np.maximum(away, 1e-9)
    found = []
    for axis in (0, 1):
        first, second = (np.take(ray, range(k, ray.shape[axis] - 1 + k), axis) for k in (0, 1))
        both = np.take(valid, range(1, valid.shape[axis]), axis) & np.take(valid, range(valid.shape[axis] - 1), axis)
        apart = np.linalg.norm(second - first, axis=-1)[both]
        found.append(float(np.median(apart)) if apart.size else _WIDEST_STEP)
    return max(found[0], 1e-5), max(found[1], 1e-5)


def _closes(where: np.ndarray, step: float, chosen: list[int]) -> bool:
    """Whether the first profile follows the last one: the turn is complete."""
    if len(chosen) < 3:
        return False
    ahead = where[:, :3, 2]
    gap = np.linalg.norm(ahead[chosen[-1]] - ahead[chosen[0]])
    usual = np.median(np.linalg.norm(np.diff(ahead[chosen], axis=0), axis=-1))
    return bool(0 < gap < 1.6 * usual and step < _WIDEST_STEP)


def _between(before: _Profile, after: _Profile, middle: np.ndarray, parts: int, reach: float) -> SurfaceSamples:
    """Samples from one profile to before the next one, `parts` on each line of a surface."""
    onward = (after.pose @ np.linalg.inv(before.pose)).astype(np.float32)
    back = np.linalg.inv(onward)
    share = (np.arange(parts, dtype=np.float32) / parts)[:, None]
    r, d = _polar(before.xyz - middle)
    s, e = _polar(after.xyz - middle)
    joined = before.valid & after.valid & _one_surface(r, s, np.linalg.norm(e - d, axis=-1))
    # Where a surface ends, its last point is carried on as the camera moves.
    _, beyond = _polar(before.xyz @ onward[:3, :3].T + onward[:3, 3] - middle)
    _, ahead = _polar(after.xyz @ back[:3, :3].T + back[:3, 3] - middle)

    def take(keep: np.ndarray, ends: tuple[np.ndarray, np.ndarray], weight: np.ndarray) -> SurfaceSamples:
        """Samples on rays between two ends, with this weight of the second profile."""
        ray = (1 - share)[..., None] * ends[0] + share[..., None] * ends[1]
        ray /= np.maximum(np.linalg.norm(ray, axis=-1, keepdims=True), 1e-9)
        # Along a plane the inverse distance changes evenly.
        xyz = ray / ((1 - weight) / r + weight / s)[..., None] + middle
        more = (
            (1 - weight)[..., None] * one + weight[..., None] * other
            for one, other in ((before.normals, after.normals), (before.rgb, after.rgb))
        )
        return SurfaceSamples(*(np.broadcast_to(part, ray.shape)[keep].astype(np.float32) for part in (xyz, *more)))

    none, whole = np.zeros_like(share), np.ones_like(share)
    groups = (
        take((share >= 0) & joined, (d, e), share),
        take((share < max(reach, 0.5 / parts)) & before.valid & ~joined, (d, beyond), none),
        take((share > 1 - reach) & after.valid & ~joined, (ahead, e), whole),
    )
    return SurfaceSamples(*(np.concatenate(fields) for fields in zip(*groups, strict=True)))


def _polar(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length and direction."""
    away = np.maximum(np.linalg.norm(way, axis=-1), 1e-9)
    return away, way / away[..., None]


def _one_surface(r: np.ndarray, s: np.ndarray, apart: np.ndarray) -> Bool[np.ndarray, "..."]:
    return np.abs(r - s) <= STEEPEST * np.minimum(r, s) * np.maximum(apart, 1e-4)
