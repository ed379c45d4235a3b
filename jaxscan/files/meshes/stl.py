"""STL, binary: triangles alone."""

import numpy as np

from jaxscan.files.disk import Part
from jaxscan.surface import Mesh


_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
_BLOCK = 1 << 20


def write_stl(mesh: Mesh, path: Part, name: str) -> None:
    """Write all faces with the normals of their planes."""
    with open(path, "wb") as file:
        file.write(f"metres {name}".encode("ascii")[:80].ljust(80))
        file.write(np.uint32(len(mesh.faces)).tobytes())
        for start in range(0, len(mesh.faces), _BLOCK):
            corners = mesh.vertices[mesh.faces[start : start + _BLOCK]]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            lengths = np.linalg.norm(normals, axis=1, keepdims=True)
            records = np.zeros(len(corners), _RECORD)
            records["corners"] = corners
            records["normal"] = normals / np.where(lengths > 0, lengths, 1)
            records.tofile(file)
