"""Calibrations for other programs: OpenCV, ROS, mrcal, Kalibr.

All count pixels alike: (0, 0) is the centre of the top-left pixel. Numbers are written so
that they are read back to the last bit.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files.disk import check_writable, write_atomically
from jaxscan.geometry import AbstractCamera, AbstractMotion, LinearStage, Turntable


CameraFormat = Literal["opencv", "ros", "mrcal", "kalibr"]

FORMAT_OF: dict[str, CameraFormat] = {".cameramodel": "mrcal", ".yaml": "opencv", ".yml": "opencv"}
"""The format that a suffix stands for, where no format is named."""

_HELD_BY: dict[CameraFormat, tuple[str, ...]] = {
    "opencv": ("brown", "rational", "fisheye"),
    "ros": ("brown", "rational", "fisheye"),
    "mrcal": ("brown", "rational"),
    "kalibr": ("brown", "fisheye", "double_sphere"),
}
"""Lenses that each format can hold."""
_LENS_NAMES = {"fisheye": "Kannala-Brandt fisheye", "double_sphere": "double sphere", "rational": "rational pinhole"}


def export_camera(calibration: Calibration, path: str | Path, camera_format: CameraFormat | None = None) -> None:
    """Write a calibration as another program reads it.

    Args:
        calibration: Its camera is written; OpenCV's file also holds laser sheets and axis, under
            keys of our own.
        path: An existing file is replaced when the new one is complete.
        camera_format: Where None, the suffix decides: `.cameramodel` is mrcal's, `.yaml` and `.yml` OpenCV's.

    Raises:
        CalibrationError: If the format is not known, cannot hold the model, or the file cannot be
            written.
    """
    path = Path(path)
    chosen = check_camera_path(path, camera_format)
    text = _WRITERS[chosen](_lens(calibration.camera, chosen, path), calibration, path)
    write_atomically(path, text.encode(), error=CalibrationError)


def check_camera_path(path: str | Path, camera_format: CameraFormat | None = None) -> CameraFormat:
    """The format of a file, after a check that the file can be written.

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


def _lens(camera: AbstractCamera, camera_format: CameraFormat, path: Path) -> str:
    """The lens: "brown" (5 coefficients) or "rational" (8) for a pinhole, otherwise the name of the camera model."""
    skew = float(getattr(camera, "skew", 0.0))
    if skew != 0.0:
        raise CalibrationError(f"{path}: the camera has a skew of {skew:g} px, which {camera_format} cannot hold.")
    pinholes = {5: "brown", 8: "rational"}
    lens = pinholes.get(len(camera.distortion), "pinhole") if camera.model == "pinhole" else camera.model
    if lens not in _HELD_BY[camera_format]:
        able = [name for name, lenses in _HELD_BY.items() if lens in lenses]
        raise CalibrationError(
            f"{path}: {camera_format} has no {_LENS_NAMES.get(lens, lens)} camera, so it cannot hold this one"
            + (f"; export it for {' or '.join(able)} instead." if able else ".")
        )
    return lens


def _opencv(lens: str, calibration: Calibration, path: Path) -> str:
    """A file for `cv2.FileStorage`; for a fisheye, coefficients as `cv2.fisheye` takes them.

    Sheets `normal . p = distance` and axis, camera frame at angle 0, metres and radians.
    """
    camera, scanner = calibration.camera, calibration.scanner
    fields = {
        "image_width": camera.width,
        "image_height": camera.height,
        "distortion_model": lens,
        "camera_matrix": _matrix(camera),
        "distortion_coefficients": _row(camera.distortion),
    }
    if scanner is not None:
        fields["jaxscan_laser_count"] = len(scanner.laser_names)
        for index, name in enumerate(scanner.laser_names):
            sheet, key = scanner.laser(index), f"jaxscan_laser_{index}"
            fields |= {
                f"{key}_name": _quoted(name),
                f"{key}_normal": _row(sheet.normal).T,
                f"{key}_distance_m": _number(sheet.distance),
                f"{key}_bow": _row(sheet.bow).T,
            }
        fields |= _motion(scanner.turntable)
    matrix = "{}: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [ {} ]"
    return "%YAML:1.0\n---\n" + _yaml(fields, matrix)


def _motion(motion: AbstractMotion) -> dict[str, object]:
    """The motion between records, under keys of our own."""
    if isinstance(motion, LinearStage):
        return {
            "jaxscan_turntable_carries": _quoted(motion.carries),
            "jaxscan_travel_direction": _row(motion.direction).T,
            "jaxscan_travel_gain": _number(motion.gain),
        }
    if not isinstance(motion, Turntable):
        return {}
    return {
        "jaxscan_turntable_carries": _quoted(motion.carries),
        "jaxscan_axis_direction": _row(motion.direction).T,
        "jaxscan_axis_point_m": _row(motion.point).T,
        "jaxscan_turntable_gain": _number(motion.gain),
        "jaxscan_turntable_harmonics": _row(motion.harmonics).T,
    }


def _quoted(text: str) -> str:
    """A string that OpenCV's reader takes back: its escapes know ASCII alone."""
    return json.dumps("".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in text))


def _ros(lens: str, calibration: Calibration, path: Path) -> str:
    """A `camera_info` file of `camera_calibration_parsers`; the image is not rectified further."""
    camera = calibration.camera
    fields = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": _matrix(camera),
        "distortion_model": {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}[lens],
        "distortion_coefficients": _row(camera.distortion),
        "rectification_matrix": np.eye(3),
        "projection_matrix": np.hstack([_matrix(camera), np.zeros((3, 1))]),
    }
    return _yaml(fields, "{}:\n  rows: {}\n  cols: {}\n  data: [{}]")


def _mrcal(lens: str, calibration: Calibration, path: Path) -> str:
    """A `.cameramodel`: a Python literal. The camera is its own reference frame."""
    camera = calibration.camera
    return (
        "{\n"
        f"    'lensmodel': 'LENSMODEL_OPENCV{len(camera.distortion)}',\n\n"
        "    # fx, fy, cx, cy, then the coefficients in OpenCV's order\n"
        f"    'intrinsics': [ {_numbers(*_pinhole(camera), *camera.distortion)} ],\n\n"
        "    # rt from the reference frame, which is the camera's own\n"
        "    'extrinsics': [ 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 ],\n\n"
        f"    'imagersize': [ {camera.width}, {camera.height} ]\n"
        "}\n"
    )


def _kalibr(lens: str, calibration: Calibration, path: Path) -> str:
    """A `camchain.yaml` of one camera, as Kalibr and Basalt read it."""
    camera = calibration.camera
    camera_model, distortion_model = "pinhole", "none"
    intrinsics, coefficients = _pinhole(camera), tuple(camera.distortion)
    if lens == "double_sphere":
        camera_model, intrinsics, coefficients = "ds", (*coefficients, *intrinsics), ()
    elif lens == "fisheye":
        distortion_model = "equidistant"
    elif coefficients[4] == 0.0:
        distortion_model, coefficients = "radtan", coefficients[:4]
    else:
        raise CalibrationError(f"{path}: kalibr has no k3, so it cannot hold this camera; calibrate it with --hold k3.")
    fields = {
        "camera_model": camera_model,
        "intrinsics": f"[{_numbers(*intrinsics)}]",
        "distortion_model": distortion_model,
        "distortion_coeffs": f"[{_numbers(*coefficients)}]",
        "resolution": f"[{camera.width}, {camera.height}]",
    }
    return "cam0:\n" + "".join(f"  {key}: {value}\n" for key, value in fields.items())


def _yaml(fields: Mapping[str, object], matrix: str) -> str:
    """A line per field; for arrays [rows, columns] the template `matrix` with name, rows, columns and numbers."""
    lines = [
        matrix.format(name, *value.shape, _numbers(*value.ravel()))
        if isinstance(value, np.ndarray)
        else f"{name}: {value}"
        for name, value in fields.items()
    ]
    return "\n".join(lines) + "\n"


def _pinhole(camera: AbstractCamera) -> tuple[object, ...]:
    return camera.fx, camera.fy, camera.cx, camera.cy


def _matrix(camera: AbstractCamera) -> np.ndarray:
    """The camera matrix [px]."""
    fx, fy, cx, cy = _row(_pinhole(camera))[0]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _row(values: object) -> np.ndarray:
    return np.asarray(values, np.float64)[None]


def _number(value: object) -> str:
    """The shortest digits that mean this float64, with the point without which YAML 1.1 sees text."""
    digits = repr(float(np.asarray(value)))
    return digits if "." in digits else digits.replace("e", ".0e")


def _numbers(*values: object) -> str:
    return ", ".join(map(_number, values))


_WRITERS: dict[CameraFormat, Callable[[str, Calibration, Path], str]] = {
    "opencv": _opencv,
    "ros": _ros,
    "mrcal": _mrcal,
    "kalibr": _kalibr,
}
