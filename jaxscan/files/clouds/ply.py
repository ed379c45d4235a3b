"""PLY, written: the format to keep and to pass on. Reading is in `ply_reader`."""

from pathlib import Path

import numpy as np

from jaxscan.files.clouds.points import Points, blocks
from jaxscan.reconstruction import PointCloud


CLOUD_FORMAT = "jaxscan-cloud/1"

_FLOATS = ("x", "y", "z", "nx", "ny", "nz")
_COLOURS = ("red", "green", "blue")
VERTEX = np.dtype(
    [(name, "<f4") for name in _FLOATS]
    + [(name, "u1") for name in _COLOURS]
    + [(name, "<f4") for name in ("intensity", "sigma", "sigma_random", "sigma_systematic")]
    # Int, not ushort, which Open3D's reader skips.
    + [("step", "<i4"), ("row", "<i4"), ("laser", "u1")]
)
PROFILE = np.dtype([("angle", "<f8"), ("record", "<i4"), ("laser", "u1")])
"""A second element after the vertices, which other readers pass over: what a profile has and its
points do not repeat. The angle is in rad from home."""

_TYPE_NAMES = {"<f4": "float", "<f8": "double", "<i4": "int", "|u1": "uchar"}


def write_ply(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write the valid points as binary little-endian PLY."""
    profiles, lines = cloud.valid.shape
    comments = [CLOUD_FORMAT, "unit metre", "frame scanner", f"grid {profiles} {lines}"]
    if digest:
        comments.append(f"calibration {digest}")
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    header += _element("vertex", int(np.count_nonzero(cloud.valid)), VERTEX) + _element("profile", profiles, PROFILE)
    per_profile = np.empty(profiles, PROFILE)
    per_profile["angle"], per_profile["record"], per_profile["laser"] = cloud.angle, cloud.record, cloud.laser
    with open(path, "wb") as file:
        file.write("\n".join([*header, "end_header", ""]).encode("ascii"))
        for points in blocks(cloud):
            file.write(_vertices(points).data)
        file.write(per_profile.data)


def _element(name: str, count: int, dtype: np.dtype) -> list[str]:
    properties = [f"property {_TYPE_NAMES[dtype[field].str]} {field}" for field in dtype.names or ()]
    return [f"element {name} {count}", *properties]


def _vertices(points: Points) -> np.ndarray:
    vertices = np.empty(len(points.step), VERTEX)
    for axis in range(3):
        vertices[_FLOATS[axis]] = points.xyz[:, axis]
        vertices[_FLOATS[axis + 3]] = points.normals[:, axis]
        vertices[_COLOURS[axis]] = points.rgb[:, axis]
    for field in ("intensity", "sigma", "sigma_random", "sigma_systematic", "step", "row", "laser"):
        vertices[field] = getattr(points, field)
    return vertices
