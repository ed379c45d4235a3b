"""The scans of an E57 file as one cloud."""

from typing import NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.grid import cloud_of
from jaxscan.reconstruction import PointCloud


_SINGLE_M = 128.0
"""Coordinates up to which a single is good to 8 um."""


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

    Of ours, on the grid with its stations; of others, the points as a single profile.

    Raises:
        CloudError: If there is no point, or grid or stations cannot be.
    """
    parts = [_in_file_frame(part, scan.pose) for scan in scans if len(part := _cartesian(scan.points, name))]
    if not parts:
        raise CloudError(f"{name}: holds no valid point.")
    together = sorted({field for part in parts for field in part.dtype.names or ()})
    types = [(field, _widest(parts, field)) for field in together]
    points = np.zeros(sum(map(len, parts)), types)
    start = 0
    for part in parts:
        for field in part.dtype.names or ():
            points[field][start : start + len(part)] = part[field]
        start += len(part)
    lines = scans[0].lines
    if lines and "profile" in together:
        points["step"] = points["profile"]
    return cloud_of(points, lines, name)


def _widest(parts: list[np.ndarray], field: str) -> np.dtype:
    return np.result_type(*(part.dtype[field] for part in parts if field in (part.dtype.names or ())))


def _cartesian(points: np.ndarray, name: str) -> np.ndarray:
    """Points that the scan calls valid, with x, y and z."""
    names = set(points.dtype.names or ())
    if "invalid" in names:
        points = points[points["invalid"] == 0]
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
    """Points and normals carried along by the pose; singles where nothing is lost by them."""
    if np.array_equal(pose, np.eye(4)):
        return points
    turned = np.stack([points[axis].astype(np.float64) for axis in "xyz"], -1) @ pose[:3, :3].T + pose[:3, 3]
    double = points.dtype["x"].itemsize > 4 or np.abs(turned).max() > _SINGLE_M
    types = [
        (field, np.dtype("f8") if double and field in ("x", "y", "z") else points.dtype[field])
        for field in points.dtype.names or ()
    ]
    moved = points.astype(types)
    for axis, values in zip("xyz", turned.T, strict=True):
        moved[axis] = values
    names = ("nx", "ny", "nz")
    if set(names) <= set(points.dtype.names or ()):
        normals = np.stack([points[name].astype(np.float64) for name in names], -1) @ pose[:3, :3].T
        for name, values in zip(names, normals.T, strict=True):
            moved[name] = values
    return moved
