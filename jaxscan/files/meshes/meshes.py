"""Meshes on disk: the suffix chooses the format."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxscan.errors import OutputError
from jaxscan.files.disk import Part, check_writable, write_together
from jaxscan.files.meshes.glb import write_glb
from jaxscan.files.meshes.obj import safe_stem, write_materials, write_obj
from jaxscan.files.meshes.ply import write_ply
from jaxscan.files.meshes.stl import write_stl
from jaxscan.surface import Mesh


# To add a format: one function (mesh, path, name of the mesh), one line here.
_WRITERS: dict[str, Callable[[Mesh, Part, str], None]] = {
    ".glb": write_glb,
    ".obj": write_obj,
    ".ply": write_ply,
    ".stl": write_stl,
}
MESH_SUFFIXES = tuple(_WRITERS)
TEXTURED_SUFFIXES = (".glb", ".obj")


def mesh_paths(path: Path, *, textured: bool) -> list[Path]:
    """The files that `save_mesh` writes: an OBJ with a texture has its material and its picture beside it."""
    if not textured or path.suffix.lower() != ".obj":
        return [path]
    stem = safe_stem(path)
    return [path.with_name(f"{stem}.jpg"), path.with_name(f"{stem}.mtl"), path]


def check_mesh_path(path: Path, *, textured: bool) -> None:
    """Check that a mesh can be written under this name, before it is computed.

    Raises:
        OutputError: If the suffix is unknown or the format has no texture, or nothing can be written there.
    """
    known = TEXTURED_SUFFIXES if textured else MESH_SUFFIXES
    if path.suffix.lower() not in known:
        what = "a mesh with a texture" if textured else "a mesh"
        raise OutputError(f'{path}: cannot write {what} as "{path.suffix}", known are {", ".join(known)}.')
    for one in mesh_paths(path, textured=textured):
        check_writable(one, error=OutputError)


def save_mesh(mesh: Mesh, path: str | Path) -> list[Path]:
    """Write a mesh, in metres.

    `.glb` (glTF 2.0) has y up, as that format says; the others have the frame of the cloud, z up. `.stl` has no
    colours. Files that are there are replaced when all new ones are complete.

    Args:
        mesh: Faces and vertices [m].
        path: Its suffix is one of `MESH_SUFFIXES`; with a texture one of `TEXTURED_SUFFIXES`.

    Returns:
        The files: with a texture, an OBJ has its `.mtl` and `.jpg` beside it.

    Raises:
        OutputError: If the suffix is unknown, the mesh has no face or is not finite, or a file cannot be written. Then
            nothing has changed.
    """
    path, textured = Path(path), mesh.texture is not None
    check_mesh_path(path, textured=textured)
    if not len(mesh.faces):
        raise OutputError(f"{path}: the mesh has no face, so there is nothing in it.")
    if not np.isfinite(mesh.vertices).all():
        raise OutputError(f"{path}: a vertex of the mesh is not finite.")
    name, writer = safe_stem(path), _WRITERS[path.suffix.lower()]
    contents: dict[Path, Callable[[Part], None]] = {path: lambda part: writer(mesh, part, name)}
    paths = mesh_paths(path, textured=textured)
    if len(paths) > 1 and mesh.texture is not None:
        # Here, so that a mesh without a texture does not load OpenCV.
        from jaxscan.vision import encode_jpeg

        picture = encode_jpeg(mesh.texture)
        contents = {
            paths[0]: lambda part: _write(part, picture),
            paths[1]: lambda part: write_materials(part, name),
            **contents,
        }
    write_together(contents, error=OutputError)
    return paths


def _write(path: Part, data: bytes) -> None:
    path.write_bytes(data)
