"""glTF 2.0 in one binary file (GLB): y up, metres."""

import json
import struct
from typing import Any

import numpy as np

from jaxscan.errors import OutputError
from jaxscan.files.disk import Part
from jaxscan.surface import Mesh


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
    _write(path, content, data)


def _write(path: Part, content: dict[str, Any], data: list[Any]) -> None:
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
