"""Cameras of other programs: read as these programs mean them, and refused in one line where they cannot be meant."""

import re

import cv2
import numpy as np
import pytest

from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files import save_calibration
from jaxscan.files.calibration import export_camera, load_camera
from jaxscan.geometry import Fisheye, Pinhole


BROWN = (-0.1012345678901234, 0.0612, 4e-4, -3.1e-5, 0.0123)
LENSES = {"brown": BROWN, "rational": (*BROWN, 0.02, -1e-05, 0.003), "fisheye": (0.031, -0.004, 0.0012, -1e-05)}
NUMBERS = {"fx": 1201.1 + 1 / 3, "fy": 1202.7, "cx": 644.2, "cy": 507.1}
SIZE = (1280, 1024)


def camera(lens):
    kind = Fisheye if lens == "fisheye" else Pinhole
    return kind(*map(np.asarray, NUMBERS.values()), np.array(LENSES[lens]), *SIZE)


def assert_same(one, other):
    """To the last bit: every writer writes the shortest digits that mean the number."""
    assert type(one) is type(other) and (one.width, one.height) == (other.width, other.height)
    np.testing.assert_array_equal(one.parameters(), other.parameters())


@pytest.mark.parametrize(
    ("name", "camera_format", "lens"),
    [
        *(("c.yaml", "opencv", lens) for lens in LENSES),
        *(("c.yml", "ros", lens) for lens in LENSES),
        *(("c.cameramodel", "mrcal", lens) for lens in ("brown", "rational")),
    ],
)
def test_every_file_that_is_written_is_read_again(tmp_path, name, camera_format, lens):
    export_camera(Calibration(camera(lens), None, (), np.zeros((0, 0))), tmp_path / name, camera_format)
    assert_same(load_camera(tmp_path / name), camera(lens))


@pytest.mark.parametrize("lens", LENSES)
def test_our_own_calibration(tmp_path, lens):
    save_calibration(Calibration(camera(lens), None, (), np.zeros((0, 0))), tmp_path / "c.json")
    assert_same(load_camera(tmp_path / "c.json"), camera(lens))


@pytest.mark.parametrize("lens", ["brown", "rational"])
def test_a_file_of_opencv_itself(tmp_path, lens):
    """As its sample `calibration.cpp` writes it, with coefficients as a column and comments of its own."""
    path = str(tmp_path / "opencv.yml")
    file = cv2.FileStorage(path, cv2.FILE_STORAGE_WRITE)
    file.write("calibration_time", "Sun Nov 22 2026")
    file.write("image_width", SIZE[0])
    file.write("image_height", SIZE[1])
    file.writeComment("flags: +fix_k4")
    file.write(
        "camera_matrix", np.array([[NUMBERS["fx"], 0, NUMBERS["cx"]], [0, NUMBERS["fy"], NUMBERS["cy"]], [0, 0, 1]])
    )
    file.write("distortion_coefficients", np.array(LENSES[lens])[:, None])
    file.write("avg_reprojection_error", 0.12)
    file.write("image_points", np.zeros((3, 5, 2), np.float32))
    file.release()
    assert_same(load_camera(path), camera(lens))


def test_a_size_that_the_file_does_not_say_comes_from_the_capture(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("K: [500.0, 0, 320, 0, 501, 240, 0, 0, 1]\nD: [-0.1, 0.01, 0, 0]\n")
    found = load_camera(path, (640, 480))
    assert (found.width, found.height) == (640, 480)
    np.testing.assert_array_equal(found.parameters(), [500, 501, 320, 240, -0.1, 0.01, 0, 0, 0])
    with pytest.raises(CalibrationError, match=r"image_width, image_height: missing"):
        load_camera(path)


def test_a_camera_info_with_its_numbers_on_lines(tmp_path):
    path = tmp_path / "c.yaml"
    lines = "".join(f"  - {value}\n" for value in (500.0, 0, 320, 0, 501, 240, 0, 0, 1))
    path.write_text(f"width: 640\nheight: 480\ndistortion_model: plumb_bob\nD: []\nK:\n{lines}")
    np.testing.assert_array_equal(load_camera(path).parameters(), [500, 501, 320, 240, 0, 0, 0, 0, 0])


GOOD = """image_width: 640
image_height: 480
distortion_model: plumb_bob
camera_matrix:
  rows: 3
  cols: 3
  data: [500, 0, 320, 0, 500, 240, 0, 0, 1]
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0, 0, 0, 0, 0]
"""
MRCAL = "{ 'lensmodel': 'LENSMODEL_OPENCV4', 'intrinsics': [500, 500, 320, 240, 0, 0, 0, 0], 'imagersize': [640, 480] }"


@pytest.mark.parametrize(
    ("found", "instead", "message"),
    [
        ("camera_matrix", "matrix", "camera_matrix: missing"),
        ("500, 0, 320", "500, 0", "camera matrix: found [500.0, 0.0, 0.0"),
        ("0, 0, 1]", "0, 0, 2]", "camera matrix: found"),
        ("[500, 0", "[.inf, 0", "camera matrix: found '.inf'"),
        ("[500, 0", "[!!python/object/apply:os.system [ls], 0", "camera matrix: found"),
        ("[500, 0", "[-500, 0", "camera.fx: found -500"),
        ("[500, 0", "[1e300, 0", "camera.fx"),
        ("image_width: 640", "image_width: many", "image_width, image_height: found 'many'"),
        ("image_width: 640", "image_width: 999999999", "width"),
        ("plumb_bob", "thin_prism", "distortion_model: found 'thin_prism'"),
        ("[0, 0, 0, 0, 0]", f"[{', '.join(['0.1'] * 14)}]", "found 14, expected at most 8"),
        ("[0, 0, 0, 0, 0]", f"[{', '.join(['0'] * 9999)}]", "found 9998 numbers, expected at most 64"),
        ("[0, 0, 0, 0, 0]", "&a [*a, *a]", "found '&a [*a, *a]'"),
    ],
)
def test_a_yaml_that_cannot_be_meant(tmp_path, found, instead, message):
    path = tmp_path / "c.yaml"
    path.write_text(GOOD)
    load_camera(path)
    assert found in GOOD
    path.write_text(GOOD.replace(found, instead))
    assert message in refusal(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MRCAL.replace("OPENCV4", "CAHVOR"), "lensmodel: found 'LENSMODEL_CAHVOR', expected one of LENSMODEL_PINHOLE"),
        (MRCAL.replace("640, 480", "640"), "imagersize"),
        (MRCAL.replace("[500, ", "['a', "), "c.cameramodel: found \"'a'\""),
        (MRCAL.replace("[500, ", "[1e999, "), "camera.fx"),
        (MRCAL.replace("[500, ", "[__import__('os').system('true'), "), "found \"__import__('os')"),
        (MRCAL.replace("[640, 480]", "[640.5, 480]"), "2 whole ones"),
        (MRCAL.replace("[500, ", "[500, " * 50), "intrinsics"),
        (MRCAL.replace("'LENSMODEL_OPENCV4'", "[1]"), "lensmodel: found ''"),
        ("[" * 5000 + "]" * 5000, "lensmodel: found ''"),
        ("", "lensmodel: found ''"),
    ],
)
def test_a_cameramodel_that_cannot_be_meant(tmp_path, text, message):
    path = tmp_path / "c.cameramodel"
    path.write_text(MRCAL)
    load_camera(path)
    path.write_text(text)
    assert message in refusal(path)


def test_a_cameramodel_with_its_optimisation(tmp_path):
    """As mrcal writes it: a comment, bytes in place of text, and a long block of base 85."""
    path = tmp_path / "c.cameramodel"
    inputs = "b'" + "P)h>@6aWAK" * 200_000 + "'"
    path.write_text(
        "# generated\n{\n" + MRCAL[1:-1].replace("'LENS", "b'LENS") + f",\n'optimization_inputs': {inputs},\n}}\n"
    )
    np.testing.assert_array_equal(load_camera(path).parameters(), [500, 500, 320, 240, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("filling", ["\n", "[", ",", "a:\n", "'intrinsics':[", "data:\n", " \n", "- 1\n"])
@pytest.mark.parametrize("name", ["c.yaml", "c.cameramodel"])
def test_megabytes_of_anything_are_read_at_once(tmp_path, name, filling):
    """Within the time limit of a test; a reader of quadratic time would take hours."""
    start = "camera_matrix:\n" if name == "c.yaml" else "'lensmodel': 'LENSMODEL_OPENCV4', "
    (tmp_path / name).write_text(start + filling * ((4 << 20) // len(filling)))
    refusal(tmp_path / name)


def test_other_files(tmp_path):
    for name, data, message in (
        ("c.xml", b"<opencv_storage/>", 'found ".xml", expected a camera as .json'),
        ("c.yaml", b"\xff\xfe\x00", "is no text"),
        ("c.yaml", b"# " + b"x" * (16 << 20), "c.yaml"),
        ("c.json", b"{}", "c.json"),
    ):
        (tmp_path / name).write_bytes(data)
        assert message in refusal(tmp_path / name)
    assert "none.yaml" in refusal(tmp_path / "none.yaml")


def refusal(path):
    with pytest.raises(CalibrationError) as caught:
        load_camera(path)
    message = str(caught.value)
    assert "\n" not in message and re.search(re.escape(path.name), message) and len(message) < 400
    return message
