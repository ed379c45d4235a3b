"""Writing PLY, the format for storage and exchange. `ply_reader` reads it."""

from pathlib import Path

import numpy as np

from jaxscan.files.clouds.points import blocks, columns, frame_of, record_of, table
from jaxscan.files.clouds.stations import station_lines
from jaxscan.reconstruction import PointCloud


CLOUD_FORMAT, JOINED_FORMAT = "jaxscan-cloud/1", "jaxscan-cloud/2"
"""Of the cloud of one station, and of a joined one: a reader of the first would take its frame for a scanner's."""

VERTEX = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [(name, "<f4") for name in ("intensity", "sigma", "sigma_random", "sigma_systematic")]
    # Int, not ushort, which Open3D's reader skips.
    + [("step", "<i4"), ("row", "<i4"), ("laser", "u1")]
)
PROFILE = np.dtype([("angle", "<f8"), ("record", "<i4"), ("laser", "u1")])
"""A second element after the vertices, which other readers ignore: the values of each profile that its
points do not repeat. The angle is in rad from home."""

JOINED_PROFILE = np.dtype([*((name, PROFILE[name].str) for name in PROFILE.names or ()), ("station", "u1")])

_TYPE_NAMES = {"<f4": "float", "<f8": "double", "<i4": "int", "|u1": "uchar"}


def write_ply(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write the valid points as binary little-endian PLY; x, y and z are doubles where the cloud holds doubles."""
    profiles, lines = cloud.valid.shape
    vertex = record_of(VERTEX, cloud)
    comments = [format_of(cloud), "unit metre", f"frame {frame_of(cloud)}", f"grid {profiles} {lines}"]
    if digest:
        comments.append(f"calibration {digest}")
    if cloud.stations is not None:
        comments += station_lines(cloud.stations)
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    header += _element("vertex", int(np.count_nonzero(cloud.valid)), vertex)
    profile = PROFILE if cloud.stations is None else JOINED_PROFILE
    header += _element("profile", profiles, profile)
    per_profile = np.empty(profiles, profile)
    if cloud.stations is not None:
        per_profile["station"] = cloud.stations.number
    per_profile["angle"], per_profile["record"], per_profile["laser"] = cloud.angle, cloud.record, cloud.laser
    with open(path, "wb") as file:
        file.write("\n".join([*header, "end_header", ""]).encode("ascii"))
        for points in blocks(cloud):
            file.write(table(columns(points), vertex).data)
        file.write(per_profile.data)


def format_of(cloud: PointCloud) -> str:
    """The format's number: a joined cloud has its own."""
    return CLOUD_FORMAT if cloud.stations is None else JOINED_FORMAT


def _element(name: str, count: int, dtype: np.dtype) -> list[str]:
    properties = [f"property {_TYPE_NAMES[dtype[field].str]} {field}" for field in dtype.names or ()]
    return [f"element {name} {count}", *properties]
