"""What meshes, drawings and other files that jaxscan writes hold, by their first lines and tables."""

import json
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxscan.errors import JaxscanError
from jaxscan.files.disk import open_regular


_HEAD = 1 << 20
"""Most bytes [bytes] that are read to tell what a file is; texts that are counted are read to their end by lines."""
_LINE = 1 << 16
_POINT_MM = 25.4 / 72
_IFC_PARTS = {"walls": b"=IFCWALL", "doors": b"=IFCDOOR(", "windows": b"=IFCWINDOW(", "spaces": b"=IFCSPACE("}
Facts = dict[str, Any]


def describe_product(path: Path, *, error: type[JaxscanError]) -> Facts | None:
    """Facts of a mesh, a drawing, a picture or a page, by their names; None for what is none of these, as a cloud.

    Args:
        path: The file; its suffix says what it should be.
        error: Type of the errors.

    Raises:
        JaxscanError: Of type `error`, if the file cannot be read or is not what its suffix says.
    """
    describe = _KINDS.get(path.suffix.lower())
    if describe is None:
        return None
    with open_regular(path, error=error) as file:
        try:
            return describe(file)
        except (
            ValueError,
            LookupError,
            TypeError,
            AttributeError,
            OverflowError,
            RecursionError,
            struct.error,
        ) as problem:
            raise error(
                f"{path}: is no {path.suffix[1:].upper()} file that can be read: {problem!r:.100}."
            ) from problem


def _ply(file: BinaryIO) -> Facts | None:
    head = file.read(_HEAD).split(b"end_header")[0].decode("ascii", "replace")
    found = dict(re.findall(r"^element (\w+) (\d{1,18})\s*$", head, re.MULTILINE))
    if not int(found.get("face", 0)):
        return None  # A cloud.
    return _mesh(found["vertex"], found["face"]) | {"unit": "metre" if "unit metre" in head else "not said"}


def _stl(file: BinaryIO) -> Facts:
    file.seek(80)
    faces = struct.unpack("<I", file.read(4))[0]
    return {"kind": "mesh", "faces": faces, "unit": "not said: STL has none, jaxscan writes metres"}


def _obj(file: BinaryIO) -> Facts:
    counts = dict.fromkeys((b"v ", b"f ", b"vt"), 0)
    for line in _lines(file):
        if line[:2] in counts:
            counts[line[:2]] += 1
    facts = _mesh(counts[b"v "], counts[b"f "]) | {"unit": "not said: OBJ has none, jaxscan writes metres", "up": "z"}
    return facts | {"texture": "yes" if counts[b"vt"] else "none"}


def _glb(file: BinaryIO) -> Facts:
    magic, _, _, length, kind = struct.unpack("<4sIIII", file.read(20))
    if magic != b"glTF" or kind != 0x4E4F534A:
        raise ValueError("no glTF")
    if length > _HEAD:
        raise ValueError("its table is too large")
    about = json.loads(file.read(length))
    shape = about["meshes"][0]["primitives"][0]
    points, corners = about["accessors"][shape["attributes"]["POSITION"]], about["accessors"][shape["indices"]]
    at = np.asarray([points["min"], points["max"]], float) + about["nodes"][0].get("translation", 0.0)
    if not np.isfinite(at).all():
        raise ValueError("its limits are not finite")
    facts = _mesh(points["count"], corners["count"] // 3) | {"unit": "metre", "up": "y"}
    return facts | {"from": at[0].tolist(), "to": at[1].tolist(), "texture": "yes" if about.get("images") else "none"}


def _mesh(vertices: Any, faces: Any) -> Facts:
    return {"kind": "mesh", "vertices": int(vertices), "faces": int(faces)}


def _svg(file: BinaryIO) -> Facts:
    head = file.read(_HEAD).decode("utf-8", "replace")
    root = re.search(r"<svg\b[^>]*>", head)
    if root is None:
        raise ValueError("no <svg>")
    sides = [re.search(rf'\b{side}="([\d.]+)mm"', root[0]) for side in ("width", "height")]
    return {"kind": "drawing", "sheet_mm": _sheet(*(float(side[1]) for side in sides if side))}


def _pdf(file: BinaryIO) -> Facts:
    head = file.read(_HEAD)
    if not head.startswith(b"%PDF-"):
        raise ValueError("no PDF")
    box = re.search(rb"/MediaBox\s*\[\s*0\s+0\s+([\d.]+)\s+([\d.]+)\s*\]", head)
    return {"kind": "drawing", "sheet_mm": _sheet(*(_POINT_MM * float(side) for side in box.groups())) if box else None}


def _png(file: BinaryIO) -> Facts:
    head = file.read(_HEAD)
    if head[:8] != b"\x89PNG\r\n\x1a\n":
        raise ValueError("no PNG")
    width, height = struct.unpack(">II", head[16:24])
    at = head.find(b"pHYs")
    *per_m, unit = struct.unpack(">IIB", head[at + 4 : at + 13]) if at > 0 else (0, 0, 0)
    sheet = _sheet(1e3 * width / per_m[0], 1e3 * height / per_m[1]) if unit == 1 and all(per_m) else None
    return {"kind": "picture", "pixels": f"{width} x {height}", "sheet_mm": sheet}


def _sheet(*sides: float) -> list[int] | None:
    return [round(side) for side in sides] if len(sides) == 2 else None


def _dxf(file: BinaryIO) -> Facts:
    dimensions = sum(line.strip() == b"DIMENSION" for line in _lines(file))
    return {"kind": "drawing", "unit": "metre", "dimensions": dimensions}


def _ifc(file: BinaryIO) -> Facts:
    if not file.readline(_LINE).startswith(b"ISO-10303-21"):
        raise ValueError("no IFC")
    counts = dict.fromkeys(_IFC_PARTS, 0)
    for line in _lines(file):
        for name, word in _IFC_PARTS.items():
            counts[name] += word in line
    return {"kind": "building (IFC)", **counts}


def _html(file: BinaryIO) -> Facts:
    title = re.search(r"<title>([^<]{0,200})</title>", file.read(_HEAD).decode("utf-8", "replace"))
    return {"kind": "page", "title": title[1] if title else None}


def _lines(file: BinaryIO) -> Iterator[bytes]:
    while line := file.readline(_LINE):
        yield line


_KINDS: dict[str, Callable[[BinaryIO], Facts | None]] = {
    ".ply": _ply,
    ".stl": _stl,
    ".obj": _obj,
    ".glb": _glb,
    ".svg": _svg,
    ".pdf": _pdf,
    ".png": _png,
    ".dxf": _dxf,
    ".ifc": _ifc,
    ".html": _html,
}
PRODUCTS = " ".join(_KINDS)
"""Suffixes of what can be described."""
