"""PLY, binary: coloured vertices and faces."""

import numpy as np

from jaxscan.files.disk import Part
from jaxscan.surface import Mesh


_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_BLOCK = 1 << 20
_TYPES = {"f4": "float", "f8": "double", "u1": "uchar"}


def write_ply(mesh: Mesh, path: Part, name: str) -> None:
    """Write vertices with normals and colours, and faces."""
    real = mesh.vertices.dtype.str[1:]
    parts = (("xyz", real), (("nx", "ny", "nz"), "f4"), (("red", "green", "blue"), "u1"))
    vertex = np.dtype([(one, f"<{kind}") for names, kind in parts for one in names])
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment jaxscan mesh, unit metre",
        f"element vertex {len(mesh.vertices)}",
        *(f"property {_TYPES[kind]} {one}" for names, kind in parts for one in names),
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        for start in range(0, len(mesh.vertices), _BLOCK):
            part = slice(start, start + _BLOCK)
            records = np.empty(len(mesh.vertices[part]), vertex)
            for (names, _), values in zip(parts, (mesh.vertices, mesh.normals, mesh.rgb), strict=True):
                for k, one in enumerate(names):
                    records[one] = values[part, k]
            records.tofile(file)
        for start in range(0, len(mesh.faces), _BLOCK):
            corners = mesh.faces[start : start + _BLOCK]
            faces = np.empty(len(corners), _FACE)
            faces["count"], faces["corners"] = 3, corners
            faces.tofile(file)
