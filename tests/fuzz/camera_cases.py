"""Cameras of other programs, changed and cut, to the reader of them all."""

import json
import random

from .draft import Case, Draft
from .nasty import nasty_number, nasty_text
from .texts import change_bytes, change_lines, change_tree, dump


_MATRIX = "[900.5, 0.0, 640.0, 0.0, 901.0, 400.0, 0.0, 0.0, 1.0]"
_YAML = (
    f"%YAML:1.0\n---\nimage_width: 1280\nimage_height: 800\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
    f"   dt: d\n   data: {_MATRIX}\ndist_coeff: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n"
    "   data: [ -0.3, 0.12,\n       0.001, -0.0005, 0.02 ]\n",
    f"width: 1280\nheight: 800\ndistortion_model: plumb_bob\nK: {_MATRIX}\nd:\n- -0.3\n- 0.1\n- 0\n- 0\n- 0\n",
    "cam0:\n  camera_model: pinhole\n  intrinsics: [900.5, 901, 640, 400]\n  distortion_model: equidistant\n"
    "  distortion_coeffs: [0.1, 0.01, 0, 0]\n  resolution: [1280, 800]\n  T:\n  - [1, 0]\n  - [0, 1]\n",
    "Camera.fx: 900\nCamera.fy: 900\nCamera.cx: 640\nCamera.cy: 400\nCamera.k1: 0.1\nCamera.width: 1280\n"
    "Camera.height: 800\n",
    "K:\n- - 900\n  - 0\n  - 640\n- [0, 900, 400]\n- {a: [0], b: {c: 1}}\nD: []\nimage_size: [1280, 800]\n",
)
_JSON = (
    {
        "camera_matrix": [[900.5, 0, 640], [0, 901, 400], [0, 0, 1]],
        "dist": [[0.1, 0.2, 0, 0, 0]],
        "image_size": [1280, 800],
    },
    {"fx": 900.5, "fy": 901.0, "ppx": 640.0, "ppy": 400.0, "coeffs": [0, 0, 0, 0, 0], "width": 1280, "height": 800},
    {"left": {"K": [1] * 9, "D": [0] * 5}, "cameras": [{"model": "opencv", "k1": 0.1}], "w": 10, "h": 10},
)
_XML = (
    '<?xml version="1.0"?>\n<opencv_storage>\n<image_Width>1280</image_Width>\n<image_Height>800</image_Height>\n'
    '<Camera_Matrix type_id="opencv-matrix">\n<rows>3</rows>\n<cols>3</cols>\n<dt>d</dt>\n<data>900 0 640 '
    "0 900 400 0 0 1</data></Camera_Matrix>\n<kc>0.1 0.2 0 0 0</kc>\n<points><_>1 2</_><_>3</_></points>\n"
    "</opencv_storage>\n"
)
_MRCAL = (
    "{ 'lensmodel': 'LENSMODEL_OPENCV4', 'intrinsics': [500, 500, 320, 240, 0, 0, 0, 0], 'imagersize': [640, 480] }"
)
_COLMAP = "# Camera list\n1 OPENCV 1280 800 900.5 901 640.5 400.5 -0.3 0.12 0.001 -0.0005\n"


def camera_case(draft: Draft) -> Case:
    """A camera in any of the forms, changed in bytes, lines or values; one line refuses what makes no sense."""
    rng = draft.rng
    suffix, data = _camera(rng)
    for _ in range(rng.choice((0, 1, 1, 2, 4))):
        data = rng.choice((change_bytes, change_lines, _other_value))(rng, data) if data else data
    path = draft.folder / f"camera{suffix}"
    path.write_bytes(data)

    def drive() -> list[str]:
        from jaxscan.errors import JaxscanError
        from jaxscan.files.calibration import read_camera

        try:
            read = read_camera(path, (1280, 800))
        except JaxscanError as problem:
            return ["lines"] if "\n" in str(problem) or len(str(problem)) > 2000 else []
        return ["lines"] if "\n" in read.note else []

    return Case("camera", [], drive=drive)


def _camera(rng: random.Random) -> tuple[str, bytes]:
    match rng.randrange(6):
        case 0 | 1:
            return rng.choice((".yaml", ".yml")), rng.choice(_YAML).encode()
        case 2:
            tree = json.loads(json.dumps(rng.choice(_JSON)))
            return ".json", dump(change_tree(rng, tree) if rng.random() < 0.7 else tree)
        case 3:
            return ".xml", _XML.encode()
        case 4:
            return ".cameramodel", _MRCAL.encode()
        case _:
            return ".txt", _COLMAP.encode()


def _other_value(rng: random.Random, data: bytes) -> bytes:
    """A word of the file is another one: a number, a bracket, any text."""
    words = data.split(b" ")
    other = rng.choice(
        (str(nasty_number(rng)), nasty_text(rng)[:200], "[", "]", "{", "}", "-", ":", "0,5", "09", ".inf")
    )
    words[rng.randrange(len(words))] = other.encode("utf-8", "replace")
    return b" ".join(words)
