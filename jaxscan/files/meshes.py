"""Meshes on disk: the suffix chooses the format."""

import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import OutputError
from jaxscan.files.disk import Part, check_writable, write_together
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


_ROWS_OF_TEXT = 1 << 17


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


def materials(name: str) -> bytes:
    """The material file that `write_obj` names: the texture without highlights."""
    lines = ("newmtl scan", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "illum 1", f"map_Ka {name}.jpg", f"map_Kd {name}.jpg")
    return ("\n".join(lines) + "\n").encode("ascii")


def _write_rows(file, line: str, values: np.ndarray, repeat: int = 0) -> None:
    """Write a line for each row, many at a time; numbers of vertices `repeat` times each, counted from 1."""
    for start in range(0, len(values), _ROWS_OF_TEXT):
        block = values[start : start + _ROWS_OF_TEXT]
        if repeat:
            block = np.repeat(block + 1, repeat, axis=1)
        file.write(line * len(block) % tuple(block.ravel().tolist()))


_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])


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


_FLOAT, _SHORT, _INT = 5126, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071


def write_glb(mesh: Mesh, path: Part, name: str) -> None:
    """Write vertices with normals, colours or the texture, and faces; the light of the room is in the colours.

    Raises:
        OutputError: If the mesh is larger than the format allows.
    """
    # Singles hold what is near the origin; where the cloud has doubles, the rest is the place of the node.
    origin = np.round(mesh.vertices.mean(0)) if mesh.vertices.dtype == np.float64 else np.zeros(3)
    at = _y_up(mesh.vertices - origin)
    attributes = {"POSITION": (at, _FLOAT, "VEC3"), "NORMAL": (_y_up(mesh.normals), _FLOAT, "VEC3")}
    if mesh.uv is not None and mesh.texture is not None:
        attributes["TEXCOORD_0"] = (mesh.uv.astype("<f4"), _FLOAT, "VEC2")
    else:
        attributes["COLOR_0"] = (_linear(mesh.rgb), _SHORT, "VEC4")
    data: list[Any] = []
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def add(content: Any, length: int, **view: Any) -> None:
        offset = views[-1]["byteOffset"] + -(-views[-1]["byteLength"] // 4) * 4 if views else 0
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": length, **view})
        data.extend((content, b"\0" * (-length % 4)))

    for values, kind, shape in attributes.values():
        accessors.append({"bufferView": len(views), "componentType": kind, "count": len(values), "type": shape})
        add(values.data, values.nbytes, target=_VERTICES)
        if kind == _SHORT:
            accessors[-1]["normalized"] = True
    accessors[0] |= {"min": at.min(0).tolist(), "max": at.max(0).tolist()}
    faces = np.ascontiguousarray(mesh.faces, "<u4")
    corners = {"bufferView": len(views), "componentType": _INT, "count": faces.size, "type": "SCALAR"}
    add(faces.data, faces.nbytes, target=_INDICES)
    primitive = {"attributes": {one: k for k, one in enumerate(attributes)}, "indices": len(accessors), "material": 0}
    material: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 1}
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "jaxscan"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"mesh": 0, "name": name, **({"translation": _y_up(origin[None])[0].tolist()} if origin.any() else {})}
        ],
        "meshes": [{"name": name, "primitives": [primitive]}],
        "accessors": [*accessors, corners],
        "bufferViews": views,
    }
    if "TEXCOORD_0" in attributes and mesh.texture is not None:
        # Here, so that a mesh without a texture does not load OpenCV.
        from jaxscan.vision import encode_jpeg

        picture = encode_jpeg(mesh.texture)
        content |= {
            "images": [{"bufferView": len(views), "mimeType": "image/jpeg"}],
            "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}],
            "textures": [{"source": 0, "sampler": 0}],
        }
        add(picture, len(picture))
        material["baseColorTexture"] = {"index": 0}
    content["materials"] = [{"pbrMetallicRoughness": material, "extensions": {"KHR_materials_unlit": {}}}]
    _write_chunk(path, content, data)


def _write_chunk(path: Part, content: dict[str, Any], data: list[Any]) -> None:
    last = content["bufferViews"][-1]
    length = last["byteOffset"] + -(-last["byteLength"] // 4) * 4
    content["buffers"] = [{"byteLength": length}]
    text = json.dumps(content, allow_nan=False).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + length
    if total >= 1 << 32:
        raise OutputError(f"a .glb holds at most 4 GiB, and this mesh needs {total / (1 << 30):.1f}; choose .ply.")
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", length, b"BIN\0"))
        for one in data:
            file.write(one)


def _y_up(vectors: np.ndarray) -> np.ndarray:
    """Vectors [n, 3] with z up as such with y up: turned about x."""
    turned = np.empty(vectors.shape, "<f4")
    turned[:, 0], turned[:, 1], turned[:, 2] = vectors[:, 0], vectors[:, 2], -vectors[:, 1]
    return turned


def _linear(rgb: np.ndarray) -> np.ndarray:
    """Colours as pictures have them in the linear light that vertices have in glTF: uint16, with alpha."""
    code = np.arange(256) / 255
    light = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    table = np.round(65535 * light).astype("<u2")
    colours = np.full((len(rgb), 4), 65535, "<u2")
    colours[:, :3] = table[rgb]
    return colours


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
    contents: dict[Path, bytes | Callable[[Part], None]] = {path: lambda part: writer(mesh, part, name)}
    paths = mesh_paths(path, textured=textured)
    if len(paths) > 1 and mesh.texture is not None:
        # Here, so that a mesh without a texture does not load OpenCV.
        from jaxscan.vision import encode_jpeg

        contents = {paths[0]: encode_jpeg(mesh.texture), paths[1]: materials(name), **contents}
    write_together(contents, error=OutputError)
    return paths
