"""Cameras of other programs: read as these programs mean them, and refused in one line where they make no sense."""

import json

import cv2
import numpy as np
import pytest

from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import export_camera, read_camera
from jaxscan.geometry import DoubleSphere, Fisheye, Pinhole

from .conftest import refused


BROWN = (-0.1012345678901234, 0.0612, 4e-4, -3.1e-5, 0.0123)
LENSES = {
    "brown": BROWN,
    "plain": (*BROWN[:4], 0.0),
    # One coefficient is so small that its shortest digits have no point.
    "rational": (*BROWN, 0.02, -1e-05, 0.003),
    "fisheye": (0.031, -0.004, 0.0012, -1e-05),
    "double_sphere": (-0.2, 0.55),
}
NUMBERS = {"fx": 1201.1 + 1 / 3, "fy": 1202.7, "cx": 644.2, "cy": 507.1}
SIZE = (1280, 1024)


def load_camera(path, size=None):
    return read_camera(path, size).camera


def camera(lens, **changes):
    kind = {"fisheye": Fisheye, "double_sphere": DoubleSphere}.get(lens, Pinhole)
    return kind(*map(np.asarray, NUMBERS.values()), np.array(LENSES[lens]), *SIZE, **changes)


def is_refused(path, message=""):
    assert len(refused(CalibrationError, lambda: load_camera(path), path.name, message)) < 400


def assert_same(one, other):
    """To the last bit: every writer writes the shortest digits that mean the number."""
    assert type(one) is type(other) and (one.width, one.height) == (other.width, other.height)
    np.testing.assert_array_equal(one.parameters(), other.parameters())


@pytest.mark.parametrize(
    ("name", "camera_format", "lens"),
    [
        *(("c.yaml", "opencv", lens) for lens in ("brown", "rational", "fisheye")),
        *(("c.yml", "ros", lens) for lens in ("brown", "rational", "fisheye")),
        *(("c.cameramodel", "mrcal", lens) for lens in ("brown", "rational")),
        *(("camchain.yaml", "kalibr", lens) for lens in ("fisheye", "double_sphere", "plain")),
    ],
)
def test_every_file_that_is_written_is_read_again(tmp_path, name, camera_format, lens):
    export_camera(Calibration(camera(lens), None, (), np.zeros((0, 0))), tmp_path / name, camera_format)
    assert_same(load_camera(tmp_path / name), camera(lens))


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
        ("camera_matrix", "thing", "camera_matrix: missing"),
        ("0, 0, 1]", "0, 0, 2]", "camera_matrix: found"),
        ("[500, 0", "[.inf, 0", "camera_matrix: found '.inf'"),
        ("[500, 0", "[!!python/object/apply:os.system [ls], 0", "camera_matrix: found"),
        ("image_width: 640", "image_width: many", "image_width: found 'many'"),
        ("plumb_bob", "thin_prism", "distortion_model: found 'thin_prism'"),
        ("5\n  data: [0, 0, 0, 0, 0]", f"14\n  data: [{', '.join(['0.1'] * 14)}]", "found 14, of which s1 = 0.1, s2"),
        ("[0, 0, 0, 0, 0]", f"[{', '.join(['0'] * 9999)}]", "found 9999 numbers, expected at most 64"),
        ("[0, 0, 0, 0, 0]", "&a [*a, *a]", "expected no alias"),
    ],
)
def test_a_yaml_that_makes_no_sense(tmp_path, found, instead, message):
    path = tmp_path / "c.yaml"
    path.write_text(GOOD)
    load_camera(path)
    assert found in GOOD
    path.write_text(GOOD.replace(found, instead))
    is_refused(path, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MRCAL.replace("OPENCV4", "CAHVOR"), "lensmodel: found 'LENSMODEL_CAHVOR', expected one of LENSMODEL_PINHOLE"),
        (MRCAL.replace("640, 480", "640"), "imagersize"),
        (MRCAL.replace("[500, ", "[__import__('os').system('true'), "), "found \"__import__('os')"),
        (MRCAL.replace("[640, 480]", "[640.5, 480]"), "expected whole pixels"),
        (MRCAL.replace("'LENSMODEL_OPENCV4'", "[1]"), "lensmodel: found ''"),
        ("[" * 5000 + "]" * 5000, "lensmodel: found ''"),
    ],
)
def test_a_cameramodel_that_makes_no_sense(tmp_path, text, message):
    path = tmp_path / "c.cameramodel"
    path.write_text(MRCAL)
    load_camera(path)
    path.write_text(text)
    is_refused(path, message)


def test_a_cameramodel_with_its_optimisation(tmp_path):
    """As mrcal writes it: a comment, bytes in place of text, and a long block of base 85."""
    path = tmp_path / "c.cameramodel"
    inputs = "b'" + "P)h>@6aWAK" * 200_000 + "'"
    path.write_text(
        "# generated\n{\n" + MRCAL[1:-1].replace("'LENS", "b'LENS") + f",\n'optimization_inputs': {inputs},\n}}\n"
    )
    np.testing.assert_array_equal(load_camera(path).parameters(), [500, 500, 320, 240, 0, 0, 0, 0, 0])


@pytest.mark.more
@pytest.mark.parametrize("filling", ["\n", "[", ",", "a:\n", "'intrinsics':[", "data:\n", " \n", "- 1\n"])
@pytest.mark.parametrize("name", ["c.yaml", "c.cameramodel"])
def test_megabytes_of_anything_are_read_at_once(tmp_path, name, filling):
    """Within the time limit of a test; a reader of quadratic time would take hours."""
    start = "camera_matrix:\n" if name == "c.yaml" else "'lensmodel': 'LENSMODEL_OPENCV4', "
    (tmp_path / name).write_text(start + filling * ((4 << 20) // len(filling)))
    is_refused(tmp_path / name)


MATRIX = [[900.5, 0.0, 640.0], [0.0, 901.0, 400.0], [0.0, 0.0, 1.0]]
FIVE = [-0.3, 0.12, 0.001, -0.0005, 0.02]
EXPECTED = [900.5, 901.0, 640.0, 400.0, *FIVE]
FOUR = [*EXPECTED[:8], 0.0]


def as_rows(key, rows):
    """As `yaml.dump` writes lists of lists."""
    return f"{key}:\n" + "".join(f"- - {row[0]}\n" + "".join(f"  - {one}\n" for one in row[1:]) for row in rows)


def flat(values):
    return ", ".join(str(one) for row in values for one in (row if isinstance(row, list) else [row]))


STRANGERS = {
    "names of scripts": ("c.yaml", f"mtx: {MATRIX}\ndist: [{FIVE}]\n", EXPECTED),
    "rows of dashes": ("c.yaml", as_rows("camera_matrix", MATRIX) + as_rows("dist_coeff", [FIVE]), EXPECTED),
    "kc of Bouguet": ("c.yaml", f"fc: [900.5, 901.0]\ncc: [640, 400]\nalpha_c: 0\nkc: {FIVE}\n", EXPECTED),
    "numbers by blanks": ("c.yaml", "K: [900.5 0 640 0 901 400 0 0 1]\nD: [-0.3 0.12 0.001 -0.0005 0.02]\n", EXPECTED),
    "on several lines": (
        "c.yaml",
        f"%YAML:1.0\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ {flat(MATRIX)[:30]}\n      "
        f"{flat(MATRIX)[30:]} ]\nD1: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ {flat(FIVE)} ]\n",
        EXPECTED,
    ),
    "ROS 2": (
        "c.yaml",
        "header:\n  frame_id: cam\nheight: 800\nwidth: 1280\ndistortion_model: plumb_bob\n"
        + "d:\n"
        + "".join(f"- {one}\n" for one in FIVE)
        + "k:\n"
        + "".join(f"- {one}\n" for row in MATRIX for one in row)
        + "roi:\n  height: 0\n  width: 0\n",
        EXPECTED,
    ),
    "Kalibr": (
        "camchain.yaml",
        "cam0:\n  T_cam_imu:\n  - [1.0, 0.0, 0.0, 0.0]\n  - [0.0, 1.0, 0.0, 0.0]\n  cam_overlaps: []\n  "
        "camera_model: pinhole\n  distortion_coeffs: [-0.3, 0.12, 0.001, -0.0005]\n  distortion_model: radtan\n  "
        "intrinsics: [900.5, 901.0, 640.0, 400.0]\n  resolution: [1280, 800]\n  rostopic: /cam0/image_raw\n",
        FOUR,
    ),
    "EuRoC": (
        "sensor.yaml",
        "# General sensor definitions.\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 1\n  data: [1.0, 0.0,\n    0.0, "
        "1]\n\nrate_hz: 20\nresolution: [1280, 800]\ncamera_model: pinhole\nintrinsics: [900.5, 901.0, 640.0, 400.0] "
        "#fu, fv, cu, cv\ndistortion_model: radial-tangential\ndistortion_coefficients: [-0.3, 0.12, 0.001, -0.0005]\n",
        FOUR,
    ),
    "ORB-SLAM": (
        "c.yaml",
        '%YAML:1.0\nCamera.type: "PinHole"\nCamera.fx: 900.5\nCamera.fy: 901.0\nCamera.cx: 640.0\nCamera.cy: 400.0\n'
        "Camera.k1: -0.3\nCamera.k2: 0.12\nCamera.p1: 0.001\nCamera.p2: -0.0005\nCamera.k3: 0.02\nCamera.fps: 30\n",
        EXPECTED,
    ),
    "RealSense": (
        "c.json",
        json.dumps(
            {
                "fx": 900.5,
                "fy": 901.0,
                "ppx": 640.0,
                "ppy": 400.0,
                "model": "Brown Conrady",
                "coeffs": FIVE,
                "width": 1280,
            }
            | {"height": 800}
        ),
        EXPECTED,
    ),
    "COLMAP": (
        "cameras.txt",
        "# Camera list\n1 OPENCV 1280 800 900.5 901.0 640.5 400.5 -0.3 0.12 0.001 -0.0005\n",
        FOUR,
    ),
}


@pytest.mark.parametrize("kind", STRANGERS)
def test_files_of_strangers(tmp_path, kind):
    name, text, expected = STRANGERS[kind]
    (tmp_path / name).write_text(text)
    read = read_camera(tmp_path / name, (1280, 800))
    np.testing.assert_array_equal(read.camera.parameters(), expected)
    assert (read.camera.width, read.camera.height) == (1280, 800)
    assert "\n" not in read.note


@pytest.mark.parametrize("suffix", [".xml", ".json", ".yaml"])
@pytest.mark.parametrize("name", ["dist_coeff", "distCoeffs", "Distortion_Coefficients"])
def test_every_name_in_every_file_of_opencv(tmp_path, suffix, name):
    path = tmp_path / f"c{suffix}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("nframes", 12)
    file.write("Camera_Matrix", np.array(MATRIX))
    file.write(name, np.array(FIVE)[:, None])
    file.write("image_points", np.random.default_rng(0).normal(size=(40, 54, 2)))
    file.release()
    read = read_camera(path, (1280, 800))
    np.testing.assert_array_equal(read.camera.parameters(), EXPECTED)
    assert name in read.note and "not used: nframes, image_points" in read.note


def test_skew_of_a_fisheye(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("distortion_model: equidistant\nK: [500, 1.5, 320, 0, 500, 240, 0, 0, 1]\nD: [0.1, 0, 0, 0]\n")
    found = load_camera(path, (640, 480))
    assert found.model == "fisheye" and float(found.skew) == 1.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"K: {MATRIX}\nlens_values: {FIVE}\n", "coefficients of the lens: missing, expected distortion_coefficients"),
        (
            f"K1: {MATRIX}\nD1: {FIVE}\nK2: {(np.array(MATRIX) @ np.diag([1.1, 1.1, 1])).tolist()}\n",
            "holds a camera matrix 2 times",
        ),
        ("K: [[900, 0, 0], [0, 900, 0], [640, 400, 1]]\nD: []\n", "is transposed, as MATLAB writes it"),
        (f"K: {MATRIX}\nD: [-0,3 0,12 0,001 -0,0005 0]\n", "decimal points"),
        (f"K: {MATRIX}\nD: [-0,3, 0,12, 0,001, -0,0005, 0,09]\n", "decimal points"),
        (f"K: {MATRIX}\nk2: 0.1\n", "k1: missing beside k2"),
        (f"K: {MATRIX}\nD: {FIVE}\ncamera_model: mei\n", "camera_model: found 'mei'"),
        (f"K: {MATRIX}\nD: {FIVE}\nimage_width: 640\n", "found only one of them"),
        ("a: [1, 2\nb: 3\n", "not readable as YAML"),
        ("a: 1\n   b: 2\n", "line 2: not readable as YAML"),
    ],
)
def test_a_part_that_is_not_found_is_missed(tmp_path, text, message):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    refused(CalibrationError, lambda: load_camera(path, (1280, 800)), message)


def test_other_files(tmp_path):
    for name, data, message in (
        ("c.mat", b"", 'found ".mat", expected a camera as .json'),
        ("c.xml", b"<opencv_storage/>", "camera_matrix: missing"),
        ("c.xml", b"<calibration><fx>1</fx></calibration>", "found <calibration>, expected <opencv_storage>"),
        ("c.yaml", b"\xff\xfe\x00", "is no text"),
        ("c.yaml", b"# " + b"x" * (16 << 20), "c.yaml"),
        ("c.json", b"{}", "c.json"),
    ):
        (tmp_path / name).write_bytes(data)
        is_refused(tmp_path / name, message)
    is_refused(tmp_path / "none.yaml")


def test_a_fisheye_of_camodocal_counts_its_coefficients_from_two(tmp_path):
    """k2 to k5 of its Kannala-Brandt are k1 to k4 of OpenCV's fisheye; mu, mv, u0, v0 are its pixels."""
    (tmp_path / "c.yaml").write_text(
        "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\nimage_width: 1280\nimage_height: 800\nprojection_parameters:\n"
        "   k2: -0.01\n   k3: 0.02\n   k4: -0.003\n   k5: 0.0004\n"
        "   mu: 400.5\n   mv: 401.0\n   u0: 640.0\n   v0: 400.0\n"
    )
    read = read_camera(tmp_path / "c.yaml")
    np.testing.assert_array_equal(read.camera.parameters(), [400.5, 401.0, 640.0, 400.0, -0.01, 0.02, -0.003, 0.0004])
    assert "every key is used" in read.note or "model_type" not in read.note.partition("not used")[2]


@pytest.mark.parametrize(("columns", "found"), [(1241, (1241, 376)), (9, None)])
def test_a_size_in_columns_and_rows_is_one_of_images_only_where_it_is_large(tmp_path, columns, found):
    """Stella writes `cols` and `rows` beside the focal lengths; a board has them too."""
    rows = 376 if found else 6
    (tmp_path / "c.yaml").write_text(
        "Camera:\n  model: perspective\n  fx: 718.856\n  fy: 718.856\n  cx: 607.19\n  cy: 185.21\n"
        f"  k1: 0.0\n  k2: 0.0\n  p1: 0.0\n  p2: 0.0\n  k3: 0.0\n  cols: {columns}\n  rows: {rows}\n"
    )
    if found is None:
        with pytest.raises(CalibrationError, match="size of the images"):
            read_camera(tmp_path / "c.yaml")
    else:
        camera = read_camera(tmp_path / "c.yaml").camera
        assert (camera.width, camera.height) == found
