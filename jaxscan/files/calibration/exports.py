"""Calibrations for other programs: OpenCV, ROS, mrcal, Kalibr.

All count pixels alike: (0, 0) is the centre of the top-left pixel. Numbers are written so
that they are read back to the last bit.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files.disk import check_writable, write_atomically
from jaxscan.geometry import Scanner


CameraFormat = Literal["opencv", "ros", "mrcal", "kalibr"]

FORMAT_OF: dict[str, CameraFormat] = {".cameramodel": "mrcal", ".yaml": "opencv", ".yml": "opencv"}
"""What a suffix means where no format is named."""


_HELD_BY: dict[CameraFormat, tuple[str, ...]] = {
    "opencv": ("brown", "rational", "fisheye"),
    "ros": ("brown", "rational", "fisheye"),
    "mrcal": ("brown", "rational"),
    "kalibr": ("brown", "fisheye", "double_sphere"),
}
"""Lenses that each format can hold."""
_LENS_NAMES = {"fisheye": "Kannala-Brandt fisheye", "double_sphere": "double sphere", "rational": "rational pinhole"}


class _Lens(NamedTuple):
    """A camera as the other programs hold it: no skew, and a list of coefficients."""

    focal: tuple[float, float]
    centre: tuple[float, float]
    model: str
    """"brown" (5 coefficients) or "rational" (8) for a pinhole, otherwise the name of the camera model."""
    coefficients: tuple[float, ...]
    width: int
    height: int

    def matrix(self) -> list[float]:
        """The camera matrix, row by row [px]."""
        return [self.focal[0], 0.0, self.centre[0], 0.0, self.focal[1], self.centre[1], 0.0, 0.0, 1.0]


def export_camera(calibration: Calibration, path: str | Path, camera_format: CameraFormat | None = None) -> None:
    """Write a calibration as another program reads it.

    Args:
        calibration: Its camera is written; OpenCV's file also holds laser sheets and axis, under
            keys of our own.
        path: An existing file is replaced when the new one is whole.
        camera_format: Where None, the suffix decides: `.cameramodel` is mrcal's, `.yaml` and `.yml` OpenCV's.

    Raises:
        CalibrationError: If the format is not known, cannot hold the model, or the file cannot be
            written.
    """
    path = Path(path)
    chosen = check_camera_path(path, camera_format)
    text = _WRITERS[chosen](_lens(calibration, chosen, path), calibration, path)
    write_atomically(path, text.encode(), error=CalibrationError)


def check_camera_path(path: str | Path, camera_format: CameraFormat | None = None) -> CameraFormat:
    """The format that a file will have, and that it can be written.

    Raises:
        CalibrationError: If the suffix names no format, or nothing can be written there.
    """
    path = Path(path)
    chosen = camera_format or FORMAT_OF.get(path.suffix.lower())
    if chosen is None:
        raise CalibrationError(
            f'{path}: "{path.suffix}" names no format of a calibration; known are {", ".join(FORMAT_OF)}, '
            f"or say --format {'|'.join(get_args(CameraFormat))}."
        )
    check_writable(path, error=CalibrationError)
    return chosen


def _lens(calibration: Calibration, camera_format: CameraFormat, path: Path) -> _Lens:
    camera = calibration.camera
    skew = float(getattr(camera, "skew", 0.0))
    if skew != 0.0:
        raise CalibrationError(f"{path}: the camera has a skew of {skew:g} px, which {camera_format} cannot hold.")
    model = {("pinhole", 5): "brown", ("pinhole", 8): "rational"}.get(
        (camera.model, len(camera.distortion)), camera.model
    )
    if model not in _HELD_BY[camera_format]:
        able = [name for name, models in _HELD_BY.items() if model in models]
        raise CalibrationError(
            f"{path}: {camera_format} has no {_LENS_NAMES.get(model, model)} camera, so it cannot hold this one"
            + (f"; export it for {' or '.join(able)} instead." if able else ".")
        )
    return _Lens(
        focal=(float(camera.fx), float(camera.fy)),
        centre=(float(camera.cx), float(camera.cy)),
        model=model,
        coefficients=_floats(camera.distortion),
        width=camera.width,
        height=camera.height,
    )


def _opencv(lens: _Lens, calibration: Calibration, path: Path) -> str:
    """A file for `cv2.FileStorage`; for a fisheye, coefficients as `cv2.fisheye` takes them."""
    lines = [
        "%YAML:1.0",
        "---",
        f"image_width: {lens.width}",
        f"image_height: {lens.height}",
        f"distortion_model: {lens.model}",
        *_opencv_matrix("camera_matrix", 3, 3, lens.matrix()),
        *_opencv_matrix("distortion_coefficients", 1, len(lens.coefficients), lens.coefficients),
    ]
    if calibration.scanner is not None:
        lines += _opencv_scanner(calibration.scanner)
    return "\n".join(lines) + "\n"


def _opencv_scanner(scanner: Scanner) -> list[str]:
    """Sheets `normal . p = distance` and axis, camera frame at angle 0, metres and radians."""
    lines = [f"jaxscan_laser_count: {len(scanner.laser_names)}"]
    for index, name in enumerate(scanner.laser_names):
        sheet, key = scanner.laser(index), f"jaxscan_laser_{index}"
        lines += [
            f"{key}_name: {_quoted(name)}",
            *_opencv_matrix(f"{key}_normal", 3, 1, _floats(sheet.normal)),
            f"{key}_distance_m: {_number(sheet.distance)}",
            *_opencv_matrix(f"{key}_bow", 2, 1, _floats(sheet.bow)),
        ]
    table = scanner.turntable
    return [
        *lines,
        f"jaxscan_turntable_carries: {_quoted(table.carries)}",
        *_opencv_matrix("jaxscan_axis_direction", 3, 1, _floats(table.direction)),
        *_opencv_matrix("jaxscan_axis_point_m", 3, 1, _floats(table.point)),
        f"jaxscan_turntable_gain: {_number(table.gain)}",
        *_opencv_matrix("jaxscan_turntable_harmonics", 4, 1, _floats(table.harmonics)),
    ]


def _opencv_matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
    head = [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
    return [*head, f"   data: [ {', '.join(map(_number, values))} ]"]


def _quoted(text: str) -> str:
    """A string that OpenCV's reader takes back: its escapes know ASCII alone."""
    return json.dumps("".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in text))


def _ros(lens: _Lens, calibration: Calibration, path: Path) -> str:
    """A `camera_info` file of `camera_calibration_parsers`; the image is not rectified further."""
    model = {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}[lens.model]
    projection = [value for row in np.reshape(lens.matrix(), (3, 3)).tolist() for value in (*row, 0.0)]
    lines = [
        f"image_width: {lens.width}",
        f"image_height: {lens.height}",
        "camera_name: camera",
        *_ros_matrix("camera_matrix", 3, 3, lens.matrix()),
        f"distortion_model: {model}",
        *_ros_matrix("distortion_coefficients", 1, len(lens.coefficients), lens.coefficients),
        *_ros_matrix("rectification_matrix", 3, 3, np.eye(3).ravel().tolist()),
        *_ros_matrix("projection_matrix", 3, 4, projection),
    ]
    return "\n".join(lines) + "\n"


def _ros_matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{', '.join(map(_number, values))}]"]


def _mrcal(lens: _Lens, calibration: Calibration, path: Path) -> str:
    """A `.cameramodel`: a Python literal. The camera is its own reference frame."""
    intrinsics = [*lens.focal, *lens.centre, *lens.coefficients]
    return (
        "{\n"
        f"    'lensmodel': 'LENSMODEL_OPENCV{len(lens.coefficients)}',\n\n"
        "    # fx, fy, cx, cy, then the coefficients in OpenCV's order\n"
        f"    'intrinsics': [ {', '.join(map(_number, intrinsics))} ],\n\n"
        "    # rt from the reference frame, which is the camera's own\n"
        "    'extrinsics': [ 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 ],\n\n"
        f"    'imagersize': [ {lens.width}, {lens.height} ]\n"
        "}\n"
    )


def _kalibr(lens: _Lens, calibration: Calibration, path: Path) -> str:
    """A `camchain.yaml` of one camera, as Kalibr and Basalt read it."""
    camera_model, distortion_model = "pinhole", "none"
    intrinsics: tuple[float, ...] = (*lens.focal, *lens.centre)
    coefficients = lens.coefficients
    if lens.model == "double_sphere":
        camera_model, intrinsics, coefficients = "ds", (*coefficients, *intrinsics), ()
    elif lens.model == "fisheye":
        distortion_model = "equidistant"
    elif coefficients[4] == 0.0:
        distortion_model, coefficients = "radtan", coefficients[:4]
    else:
        raise CalibrationError(f"{path}: kalibr has no k3, so it cannot hold this camera; calibrate it with --hold k3.")
    lines = [
        "cam0:",
        f"  camera_model: {camera_model}",
        f"  intrinsics: [{', '.join(map(_number, intrinsics))}]",
        f"  distortion_model: {distortion_model}",
        f"  distortion_coeffs: [{', '.join(map(_number, coefficients))}]",
        f"  resolution: [{lens.width}, {lens.height}]",
    ]
    return "\n".join(lines) + "\n"


def _number(value: object) -> str:
    """The shortest digits that mean this float64, with the point without which YAML 1.1 sees text."""
    digits = repr(float(np.asarray(value)))
    return digits if "." in digits else digits.replace("e", ".0e")


def _floats(values: object) -> tuple[float, ...]:
    return tuple(float(value) for value in np.asarray(values, np.float64))


_WRITERS: dict[CameraFormat, Callable[[_Lens, Calibration, Path], str]] = {
    "opencv": _opencv,
    "ros": _ros,
    "mrcal": _mrcal,
    "kalibr": _kalibr,
}
