"""Cameras of other programs: OpenCV's and ROS' YAML, mrcal's `.cameramodel`, and our own calibrations.

The files may come from anyone. A small reader knows the few forms in which these programs write numbers; nothing
in a file is ever executed.
"""

import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from jaxscan.errors import CalibrationError
from jaxscan.files.calibration.calibration import load_parts
from jaxscan.files.calibration.model import CALIBRATION_FORMAT, CalibrationTable
from jaxscan.files.disk import MEGABYTE, check, read_bounded
from jaxscan.geometry import CAMERAS, AbstractCamera


MAX_CAMERA_BYTES = 16 * MEGABYTE
_MAX_NUMBERS = 64

_WIDTHS, _HEIGHTS = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_MATRICES = ("camera_matrix", "Camera_Matrix", "K", "k")
_COEFFICIENTS = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "D", "d")
_FISHEYE = ("fisheye", "equidistant", "kannala_brandt")
_PINHOLE = ("", "brown", "rational", "plumb_bob", "rational_polynomial", "pinhole", "none")
_KEY = re.compile(r"^([A-Za-z_][A-Za-z0-9_]*)\s*:(.*)$")
_NUMBER = re.compile(r"[-+]?(?:\.\d+|\d+\.?\d*)(?:[eE][-+]?\d+)?")


def load_camera(
    path: str | Path, size: tuple[int, int] | None = None, *, unnamed: Literal["pinhole", "fisheye"] = "pinhole"
) -> AbstractCamera:
    """A camera from a file of another program, or from a calibration of our own.

    Args:
        path: `.json` is our own, `.cameramodel` mrcal's (LENSMODEL_PINHOLE, LENSMODEL_OPENCV4, 5 or 8), `.yaml` and
            `.yml` are OpenCV's or a ROS camera_info.
        size: Width and height of the images [px], for a file that does not say.
        unnamed: The model of a `.yaml` that names none, as OpenCV's own samples write them: k1, k2, p1, p2 of a
            pinhole look like k1 to k4 of a fisheye.

    Returns:
        The camera; a pinhole has 5 coefficients, or 8 where the file has more.

    Raises:
        CalibrationError: One line with the key, the value found and the values allowed.
    """
    path = Path(path)
    yaml = functools.partial(_yaml, unnamed=unnamed)
    readers: dict[str, Callable[..., dict[str, Any]]] = {".cameramodel": _mrcal, ".yaml": yaml, ".yml": yaml}
    suffix = path.suffix.lower()
    if suffix == ".json":
        return load_parts(path)[0]
    if suffix not in readers:
        raise CalibrationError(
            f'{path}: found "{path.suffix}", expected a camera as .json (ours), .yaml (OpenCV, ROS) or .cameramodel '
            "(mrcal)."
        )
    data = read_bounded(path, MAX_CAMERA_BYTES, error=CalibrationError)
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise CalibrationError(f"{path}: is no text, expected the camera that its suffix names.") from None
    table = readers[suffix](text, str(path), size)
    tables = {"format": CALIBRATION_FORMAT, "camera": table}
    return check(CalibrationTable, tables, name=str(path), error=CalibrationError).camera.camera()


def _yaml(text: str, name: str, size: tuple[int, int] | None, *, unnamed: str) -> dict[str, Any]:
    blocks = _blocks(text)
    matrix = _numbers(_one(blocks, _MATRICES, name), f"{name}: camera matrix")
    if len(matrix) != 9 or [matrix[i] for i in (3, 6, 7)] != [0, 0, 0] or matrix[8] != 1:
        raise CalibrationError(f"{name}: camera matrix: found {matrix[:9]}, expected [fx s cx; 0 fy cy; 0 0 1].")
    fx, skew, cx, _, fy, cy, *_ = matrix
    model = blocks.get("distortion_model", "").strip().strip("\"'").lower()
    fisheye = (model or unnamed) in _FISHEYE or blocks.get("fisheye_model", "").strip() in ("1", "true")
    if not fisheye and model not in _PINHOLE:
        raise CalibrationError(
            f"{name}: distortion_model: found {model!r:.40}, expected plumb_bob, rational_polynomial or equidistant."
        )
    given = next((blocks[key] for key in _COEFFICIENTS if key in blocks), "[]")
    lens = _numbers(given, f"{name}: distortion coefficients")
    width, height = (
        _size(next((blocks[key] for key in keys if key in blocks), None), None if size is None else size[side], name)
        for side, keys in enumerate((_WIDTHS, _HEIGHTS))
    )
    return _table((fx, fy, cx, cy), lens, (width, height), name, fisheye=fisheye, skew=skew)


def _mrcal(text: str, name: str, size: tuple[int, int] | None) -> dict[str, Any]:
    # Looked for rather than parsed: a model may hold megabytes of its optimisation, and a parser takes far more.
    text = re.sub(r"#[^\n]*", "", text)
    lens = (re.findall(r"""['"]lensmodel['"]\s*:\s*b?['"]([^'"\n]*)['"]""", text) or [""])[0]
    counts = {"LENSMODEL_PINHOLE": 0, **{f"LENSMODEL_OPENCV{count}": count for count in (4, 5, 8)}}
    if lens not in counts:
        raise CalibrationError(f"{name}: lensmodel: found {lens!r:.60}, expected one of {', '.join(counts)}.")
    lists = (re.findall(rf"""['"]{key}['"]\s*:\s*(\[[^\[\]]*\])""", text) for key in ("intrinsics", "imagersize"))
    numbers, given = (_numbers(found[0], name) if found else [] for found in lists)
    if len(numbers) != 4 + counts[lens] or len(given) != 2 or not all(side.is_integer() for side in given):
        raise CalibrationError(
            f"{name}: intrinsics, imagersize: found {len(numbers)} and {len(given)} numbers, expected "
            f"{4 + counts[lens]} and 2 whole ones, as {lens} has them."
        )
    return _table(numbers[:4], numbers[4:], (int(given[0]), int(given[1])), name)


def _table(
    pixels: Sequence[float],
    lens: Sequence[float],
    size: tuple[int, int],
    name: str,
    *,
    fisheye: bool = False,
    skew: float = 0.0,
) -> dict[str, Any]:
    """The camera as a calibration of our own holds it."""
    model = "fisheye" if fisheye else "pinhole"
    names = [one for block in CAMERAS[model].lens for one in block.parameters]
    lens = [float(value) for value in lens]
    while len(lens) > len(names) and lens[-1] == 0:
        lens = lens[:-1]
    if fisheye and len(lens) > 4 and not any(lens[4:]):
        lens = lens[:4]
    if len(lens) > len(names):
        raise CalibrationError(
            f"{name}: distortion coefficients: found {len(lens)}, expected at most {len(names)}: thin prisms and "
            "tilted sensors are not known here."
        )
    # Shorter lists leave out coefficients that are 0; k4, k5, k6 come together.
    full = len(names) if fisheye or len(lens) > 5 else 5
    lens += [0.0] * (full - len(lens))
    numbers = dict(zip(("fx", "fy", "cx", "cy"), map(float, pixels), strict=True))
    distortion = dict(zip(names, lens, strict=False))
    return {"model": model, "width": size[0], "height": size[1], **numbers, "skew": skew, "distortion": distortion}


def _blocks(text: str) -> dict[str, str]:
    """The top-level keys of a YAML file, each with the text up to the next."""
    blocks: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if line.startswith(("#", "%", "---", "...")):
            continue
        found = _KEY.match(line)
        if found:
            lines = blocks.setdefault(found[1], [])
            lines.append(found[2])
        else:
            lines.append(line)
    return {key: "\n".join(block) for key, block in blocks.items()}


def _one(blocks: Mapping[str, str], names: Sequence[str], name: str) -> str:
    for key in names:
        if key in blocks:
            return blocks[key]
    raise CalibrationError(f"{name}: {names[0]}: missing, expected a camera of OpenCV or a ROS camera_info.")


def _numbers(block: str, where: str) -> list[float]:
    """The numbers of a list, or of the list `data` of a matrix: in brackets, or one on each line after a dash."""
    matrix = re.search(r"^[ \t]*data[ \t]*:", block, re.MULTILINE)
    body = block[matrix.end() :] if matrix else block
    flow = re.match(r"\s*\[([^\[\]]*)\]\s*$", body)
    separator, body = (",", flow[1]) if flow else ("\n", body.strip())
    if body.count(separator) > _MAX_NUMBERS:
        raise CalibrationError(f"{where}: found {body.count(separator)} numbers, expected at most {_MAX_NUMBERS}.")
    words = [word.strip() if flow else word.strip().removeprefix("-").strip() for word in body.split(separator)]
    words = [word for word in words if word]
    for word in words:
        if not _NUMBER.fullmatch(word):
            raise CalibrationError(f"{where}: found {word!r:.40}, expected numbers in a list.")
    return [float(word) for word in words]


def _size(block: str | None, known: int | None, name: str) -> int:
    if block is None:
        if known is None:
            raise CalibrationError(f"{name}: image_width, image_height: missing, expected the size of the images.")
        return known
    if not re.fullmatch(r"\s*\d{1,9}\s*", block):
        raise CalibrationError(f"{name}: image_width, image_height: found {block.strip()!r:.40}, expected pixels.")
    return int(block)
