"""Writing PLY, the format for storage and exchange. `reader` reads it."""

import numpy as np

from jaxscan.files.clouds.about import About, header_lines
from jaxscan.files.clouds.points import POINT, blocks, columns, record_of, table
from jaxscan.files.clouds.seal import SEAL_LINE, seal
from jaxscan.files.disk import Part
from jaxscan.reconstruction import PointCloud


# Int, not ushort, which Open3D's reader skips; the angle in double and the record are in the profiles.
VERTEX = np.dtype(
    [(name, "<f4" if name == "angle" else POINT[name].str) for name in POINT.names or () if name != "record"]
)
PROFILE = np.dtype([("angle", "<f8"), ("record", "<i4"), ("laser", "u1")])
"""A second element after the vertices, which other readers ignore: the values of each profile, also of those
without a point. The angle is in rad from home."""

JOINED_PROFILE = np.dtype([*((name, PROFILE[name].str) for name in PROFILE.names or ()), ("station", "u1")])

_TYPE_NAMES = {"<f4": "float", "<f8": "double", "<i4": "int", "|u1": "uchar"}
_GEOMETRY = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"}


def write_ply(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the valid points as binary little-endian PLY; x, y and z are doubles where the cloud holds doubles.

    All but coordinates, normals and colours begin with `scalar_`: CloudCompare keeps only numbers of such names,
    and MeshLab would take `intensity` for the colour.
    """
    profiles = len(cloud.valid)
    vertex = record_of(VERTEX, cloud)
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {line}" for line in (*header_lines(cloud, about), SEAL_LINE)]
    header += _element("vertex", int(np.count_nonzero(cloud.valid)), vertex)
    profile = PROFILE if cloud.stations is None else JOINED_PROFILE
    gridded = "grid" not in cloud.lacks
    header += _element("profile", profiles, profile, plain=True) if gridded else []
    per_profile = np.empty(profiles, profile)
    if cloud.stations is not None:
        per_profile["station"] = cloud.stations.number
    per_profile["angle"], per_profile["record"], per_profile["laser"] = cloud.angle, cloud.record, cloud.laser
    with open(path, "wb") as file:
        file.write("\n".join([*header, "end_header", ""]).encode("ascii"))
        for points in blocks(cloud):
            file.write(table(columns(points, cloud), vertex).data)
        if gridded:
            file.write(per_profile.data)
    seal(path)


def _element(name: str, count: int, dtype: np.dtype, *, plain: bool = False) -> list[str]:
    names = dtype.names or ()
    spelled = {field: field if plain or field in _GEOMETRY else f"scalar_{field}" for field in names}
    return [
        f"element {name} {count}",
        *(f"property {_TYPE_NAMES[dtype[field].str]} {spelled[field]}" for field in names),
    ]
