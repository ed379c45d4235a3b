"""Calibrations for other programs: the cameras that they read see the same pixels."""

import ast
import dataclasses
import re

import cv2
import jax
import numpy as np
import pytest

from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import export_camera
from jaxscan.geometry import LaserSheet, Scanner, Turntable, stack_lasers

from .test_known_cameras import LENSES, camera


MODELS = ("brown", "rational", "fisheye")
# Rounding of float64 at 2000 px is 2e-13; the order of summation differs.
SAME_PX = 1e-9


def calibration(model, *, name="red", **changes):
    sheet = dataclasses.replace(LaserSheet.from_plane(np.array([0.99, -0.01, 0.14]), 0.2), bow=np.array([1e-5, 2e-4]))
    table = Turntable.from_axis(np.array([0.01, -0.9999, 0.012]), np.array([0.02, 0.0, -0.15]), gain=-1.0002)
    seen = camera(model, **changes)
    scanner = Scanner(seen, stack_lasers([sheet]), table, laser_names=(name,))
    return Calibration(seen, scanner, (), np.zeros((0, 0)))


def points():
    random = np.random.default_rng(3)
    return np.column_stack([random.uniform(-0.4, 0.4, (200, 2)), np.ones(200)]) * random.uniform(0.3, 5, (200, 1))


def seen_by_us(model):
    return np.asarray(jax.vmap(camera(model).project)(points()))


def seen_by_opencv(model, matrix, coefficients):
    still = np.zeros(3)
    if model == "fisheye":
        return cv2.fisheye.projectPoints(points()[:, None], still, still, matrix, coefficients)[0][:, 0]
    return cv2.projectPoints(points(), still, still, matrix, coefficients)[0][:, 0]


def opened(text):
    return cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)


class TestOpenCV:
    @pytest.mark.parametrize("model", MODELS)
    @pytest.mark.parametrize("suffix", [".yaml", ".yml"])
    def test_sees_the_same_pixels(self, tmp_path, model, suffix):
        path = tmp_path / f"camera{suffix}"
        export_camera(calibration(model), path)
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        assert [file.getNode(f"image_{side}").real() for side in ("width", "height")] == [1280, 1024]
        matrix, coefficients = (file.getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients"))
        np.testing.assert_allclose(seen_by_opencv(model, matrix, coefficients), seen_by_us(model), rtol=0, atol=SAME_PX)

    def test_sheet_and_axis_to_the_last_bit(self, tmp_path):
        made, path = calibration("brown"), tmp_path / "a.yaml"
        export_camera(made, path)
        file, scanner = opened(path.read_text()), made.scanner
        for key, value in {
            "laser_0_normal": scanner.laser(0).normal,
            "laser_0_bow": scanner.laser(0).bow,
            "axis_direction": scanner.turntable.direction,
            "axis_point_m": scanner.turntable.point,
            "turntable_harmonics": scanner.turntable.harmonics,
        }.items():
            np.testing.assert_array_equal(file.getNode(f"jaxscan_{key}").mat()[:, 0], np.asarray(value))
        assert file.getNode("jaxscan_laser_0_distance_m").real() == float(scanner.laser(0).distance)
        assert file.getNode("jaxscan_turntable_gain").real() == -1.0002
        assert file.getNode("jaxscan_turntable_carries").string() == "scanner"

    @pytest.mark.parametrize("name", ['a"b', "a\\b", "a: {b}\ncamera_matrix: 1", "rot ß", "a\x00b"])
    def test_hostile_laser_names_change_nothing_else(self, tmp_path, name):
        export_camera(calibration("brown", name=name), tmp_path / "a.yaml")
        file = opened((tmp_path / "a.yaml").read_text())
        assert file.getNode("jaxscan_laser_0_name").string() == re.sub(r"[^ -~]", "?", name)
        assert file.getNode("camera_matrix").mat()[0, 0] == 1201.1 + 1 / 3
        assert file.getNode("jaxscan_turntable_gain").real() == -1.0002


class TestROS:
    MODEL = {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}  # noqa: RUF012

    @pytest.mark.parametrize("model", MODELS)
    def test_sees_the_same_pixels(self, tmp_path, model):
        path = tmp_path / "camera.yaml"
        export_camera(calibration(model), path, "ros")
        # OpenCV reads YAML that announces itself as such; the rest is flat enough for it.
        file = opened("%YAML:1.0\n---\n" + path.read_text())
        assert file.getNode("distortion_model").string() == self.MODEL[model]
        assert [file.getNode(f"image_{side}").real() for side in ("width", "height")] == [1280, 1024]

        def matrix(key):
            node = file.getNode(key)
            values = [node.getNode("data").at(i).real() for i in range(node.getNode("data").size())]
            return np.array(values).reshape(int(node.getNode("rows").real()), int(node.getNode("cols").real()))

        seen = seen_by_opencv(model, matrix("camera_matrix"), matrix("distortion_coefficients"))
        np.testing.assert_allclose(seen, seen_by_us(model), rtol=0, atol=SAME_PX)
        np.testing.assert_array_equal(matrix("rectification_matrix"), np.eye(3))
        np.testing.assert_array_equal(matrix("projection_matrix")[:, :3], matrix("camera_matrix"))
        assert not matrix("projection_matrix")[:, 3].any()

    @pytest.mark.parametrize("model", MODELS)
    def test_every_number_has_the_point_that_yaml_1_1_asks_for(self, tmp_path, model):
        """PyYAML, which ROS reads with, takes 1e-05 for a string."""
        export_camera(calibration(model), tmp_path / "a.yaml", "ros")
        numbers = re.findall(r"data: \[(.*)\]", (tmp_path / "a.yaml").read_text())
        # The float of YAML 1.1, as its type repository has it.
        pattern = re.compile(r"[-+]?[0-9][0-9_]*\.[0-9_]*([eE][-+][0-9]+)?")
        found = [number for line in numbers for number in line.split(", ")]
        assert len(found) == 9 + len(LENSES[model]) + 9 + 12
        assert all(pattern.fullmatch(number) for number in found)


class TestMrcal:
    @pytest.mark.parametrize("model", ["brown", "rational"])
    def test_sees_the_same_pixels(self, tmp_path, model):
        """Read as mrcal reads it, a Python literal, and projected by the formula of its LENSMODEL_OPENCV."""
        path = tmp_path / "camera.cameramodel"
        export_camera(calibration(model), path)
        read = ast.literal_eval(path.read_text())
        assert read["lensmodel"] == {"brown": "LENSMODEL_OPENCV5", "rational": "LENSMODEL_OPENCV8"}[model]
        assert read["imagersize"] == [1280, 1024]
        assert read["extrinsics"] == [0.0] * 6
        fx, fy, cx, cy, k0, k1, k2, k3, k4, *more = read["intrinsics"]
        k5, k6, k7 = more or (0.0, 0.0, 0.0)
        x, y = (points()[:, :2] / points()[:, 2:]).T
        r2 = x * x + y * y
        radial = (1 + k0 * r2 + k1 * r2**2 + k4 * r2**3) / (1 + k5 * r2 + k6 * r2**2 + k7 * r2**3)
        u = fx * (x * radial + 2 * k2 * x * y + k3 * (r2 + 2 * x * x)) + cx
        v = fy * (y * radial + k2 * (r2 + 2 * y * y) + 2 * k3 * x * y) + cy
        np.testing.assert_allclose(np.column_stack([u, v]), seen_by_us(model), rtol=0, atol=SAME_PX)


class TestKalibr:
    @staticmethod
    def read(path):
        """The few lines of YAML, read as such."""
        head, *lines = path.read_text().splitlines()
        assert head == "cam0:"
        pairs = [re.fullmatch(r"  (\w+): (.*)", line).groups() for line in lines]
        return {key: ast.literal_eval(value) if value.startswith("[") else value for key, value in pairs}

    @pytest.mark.parametrize(("model", "distortion"), [("plain", "radtan"), ("fisheye", "equidistant")])
    def test_a_pinhole_and_a_fisheye(self, tmp_path, model, distortion):
        export_camera(calibration(model), tmp_path / "camchain.yaml", "kalibr")
        found = self.read(tmp_path / "camchain.yaml")
        assert (found["camera_model"], found["distortion_model"]) == ("pinhole", distortion)
        assert found["resolution"] == [1280, 1024]
        fu, fv, pu, pv = found["intrinsics"]
        matrix, coefficients = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]]), np.array(found["distortion_coeffs"])
        assert len(coefficients) == 4
        seen = seen_by_opencv(model, matrix, coefficients)
        np.testing.assert_allclose(seen, seen_by_us(model), rtol=0, atol=SAME_PX)

    def test_a_double_sphere(self, tmp_path):
        export_camera(calibration("double_sphere"), tmp_path / "camchain.yaml", "kalibr")
        found = self.read(tmp_path / "camchain.yaml")
        assert (found["camera_model"], found["distortion_model"], found["distortion_coeffs"]) == ("ds", "none", [])
        xi, alpha, fu, fv, pu, pv = found["intrinsics"]
        assert (xi, alpha) == LENSES["double_sphere"]
        p = points()
        d1 = np.linalg.norm(p, axis=1)
        d2 = np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + (xi * d1 + p[:, 2]) ** 2)
        scale = alpha * d2 + (1 - alpha) * (xi * d1 + p[:, 2])
        seen = np.column_stack([fu * p[:, 0] / scale + pu, fv * p[:, 1] / scale + pv])
        np.testing.assert_allclose(seen, seen_by_us("double_sphere"), rtol=0, atol=SAME_PX)


class TestRefused:
    @pytest.mark.parametrize(
        ("model", "camera_format", "said"),
        [
            ("double_sphere", "opencv", r"opencv has no double sphere camera.*export it for kalibr instead"),
            ("rational", "kalibr", "kalibr has no rational pinhole camera.*export it for opencv or ros or mrcal"),
            ("brown", "kalibr", "kalibr has no k3.*--hold k3"),
        ],
    )
    def test_a_lens_that_the_format_lacks(self, tmp_path, model, camera_format, said):
        with pytest.raises(CalibrationError, match=said):
            export_camera(calibration(model), tmp_path / "a.yaml", camera_format)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("camera_format", ["opencv", "ros", "mrcal", "kalibr"])
    def test_skew(self, tmp_path, camera_format):
        with pytest.raises(CalibrationError, match=rf"skew of 0\.25 px, which {camera_format} cannot hold"):
            export_camera(calibration("brown", skew=np.asarray(0.25)), tmp_path / "a.yaml", camera_format)
        assert list(tmp_path.iterdir()) == []

    def test_a_suffix_that_names_no_format(self, tmp_path):
        with pytest.raises(CalibrationError, match=r'"\.xml" names no format.*--format'):
            export_camera(calibration("brown"), tmp_path / "a.xml")
