"""Wavefront OBJ, with its material and the picture of its texture beside it."""

import re
from pathlib import Path

import numpy as np

from jaxscan.files.disk import Part
from jaxscan.surface import Mesh


_BLOCK = 1 << 17


def safe_stem(path: Path) -> str:
    """The name of a mesh without what other programs do not read in a reference: blanks and signs become lines."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", path.stem).strip(".") or "mesh"


def write_obj(mesh: Mesh, path: Part, name: str) -> None:
    """Write vertices with normals, and with colours or places in the texture, and faces."""
    textured = mesh.uv is not None and mesh.texture is not None
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write("# jaxscan mesh, unit metre, z up\n")
        if textured:
            file.write(f"mtllib {name}.mtl\n")
        file.write(f"o {name}\n")
        if textured and mesh.uv is not None:
            _write_rows(file, "v %.9g %.9g %.9g\n", mesh.vertices)
            # The first row of the picture is at the top, where v is 1.
            _write_rows(file, "vt %.7f %.7f\n", np.stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]], 1))
        else:
            coloured = np.concatenate([mesh.vertices, mesh.rgb.astype(np.float32) / 255], 1)
            _write_rows(file, "v %.9g %.9g %.9g %.4f %.4f %.4f\n", coloured)
        _write_rows(file, "vn %.4f %.4f %.4f\n", mesh.normals)
        if textured:
            file.write("usemtl scan\n")
        corner = "%d/%d/%d" if textured else "%d//%d"
        _write_rows(file, f"f {corner} {corner} {corner}\n", mesh.faces, repeat=3 if textured else 2)


def write_materials(path: Part, name: str) -> None:
    """Write the material that `write_obj` names: the picture as it is, without shine."""
    lines = ("newmtl scan", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "illum 1", f"map_Ka {name}.jpg", f"map_Kd {name}.jpg")
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def _write_rows(file, line: str, values: np.ndarray, repeat: int = 0) -> None:
    """Write a line for each row, many at a time; numbers of vertices `repeat` times each, counted from 1."""
    for start in range(0, len(values), _BLOCK):
        block = values[start : start + _BLOCK]
        if repeat:
            block = np.repeat(block + 1, repeat, axis=1)
        file.write(line * len(block) % tuple(block.ravel().tolist()))
