"""The scans of an E57 file as one cloud."""

from typing import NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.grid import cloud_of
from jaxscan.reconstruction import PointCloud


_SINGLE_M = 128.0
"""Coordinates up to which a single is good to 8 um."""
_BLOCK = 1 << 18
_AXES, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")


class Scan(NamedTuple):
    """A scan as it is stored."""

    points: np.ndarray
    """Structured array [n], in the scan's own frame."""
    pose: np.ndarray
    """T_file_scan [4, 4]."""
    lines: list[str]
    """The lines of our header; none where another program wrote it."""


def joined(scans: list[Scan], name: str) -> PointCloud:
    """The cloud of all scans, in the frame of the file.

    Of ours, on the grid with its stations; of others, the points as a single profile. The list is emptied.

    Raises:
        CloudError: If there is no point, or grid or stations cannot be.
    """
    lines, parts = scans[0].lines, []
    # Each is let go of as it is taken over, so that a cloud is in memory once.
    while scans:
        scan = scans.pop(0)
        if len(part := _cartesian(scan.points, name)):
            parts.append(_in_file_frame(part, scan.pose))
        del scan, part
    if not parts:
        raise CloudError(f"{name}: holds no valid point.")
    points = parts.pop() if len(parts) == 1 else _concatenated(parts)
    if lines and "profile" in (points.dtype.names or ()):
        points["step"] = points["profile"]
    return cloud_of(points, lines, name)


def _concatenated(parts: list[np.ndarray]) -> np.ndarray:
    together = sorted({field for part in parts for field in part.dtype.names or ()})
    points = np.zeros(sum(map(len, parts)), [(field, _widest(parts, field)) for field in together])
    start = 0
    while parts:
        part = parts.pop(0)
        for field in part.dtype.names or ():
            points[field][start : start + len(part)] = part[field]
        start += len(part)
        del part
    return points


def _widest(parts: list[np.ndarray], field: str) -> np.dtype:
    return np.result_type(*(part.dtype[field] for part in parts if field in (part.dtype.names or ())))


def _cartesian(points: np.ndarray, name: str) -> np.ndarray:
    """Points that the scan calls valid, with x, y and z."""
    names = set(points.dtype.names or ())
    if "invalid" in names:
        valid = points["invalid"] == 0
        points = points if valid.all() else points[valid]
    spherical = {"range", "azimuth", "elevation"}
    if not ({"x", "y", "z"} <= names or spherical <= names):
        raise CloudError(f"{name}: the points have no x, y and z.")
    if "x" in names:
        kept = [field for field in points.dtype.names or () if field not in spherical | {"invalid"}]
        return points[kept] if len(kept) < len(names) else points
    kept = [field for field in points.dtype.names or () if field not in spherical | {"invalid"}]
    found = np.empty(len(points), [("x", "f8"), ("y", "f8"), ("z", "f8"), *((f, points.dtype[f].str) for f in kept)])
    distance, azimuth, elevation = (points[field].astype(np.float64) for field in ("range", "azimuth", "elevation"))
    found["x"] = distance * np.cos(elevation) * np.cos(azimuth)
    found["y"] = distance * np.cos(elevation) * np.sin(azimuth)
    found["z"] = distance * np.sin(elevation)
    for field in kept:
        found[field] = points[field]
    return found


def _in_file_frame(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points and normals carried along by the pose, in place; singles where nothing is lost by them."""
    if np.array_equal(pose, np.eye(4)):
        return points
    blocks = [slice(start, start + _BLOCK) for start in range(0, len(points), _BLOCK)]

    def turned(block: slice, names: tuple[str, ...]) -> np.ndarray:
        return np.stack([points[name][block].astype(np.float64) for name in names], -1) @ pose[:3, :3].T

    double = points.dtype["x"].itemsize > 4
    if not double and any(np.abs(turned(block, _AXES) + pose[:3, 3]).max() > _SINGLE_M for block in blocks):
        names = points.dtype.names or ()
        points = points.astype([(name, np.dtype("f8") if name in _AXES else points.dtype[name]) for name in names])
    for block in blocks:
        for axis, values in zip(_AXES, (turned(block, _AXES) + pose[:3, 3]).T, strict=True):
            points[axis][block] = values
        if set(_NORMAL) <= set(points.dtype.names or ()):
            for axis, values in zip(_NORMAL, turned(block, _NORMAL).T, strict=True):
                points[axis][block] = values
    return points
