"""Parts of a rig that a command line gives as numbers or files."""

import json

import cv2
import numpy as np
import pytest

from jaxscan import load_scanner, open_capture
from jaxscan.cli.calibrate import known_parts
from jaxscan.errors import OptionError


POINT, DIRECTION = [0.1, 0.0, 0.6], [0.02, -1.0, 0.01]
PLANES = {"left": ([1.0, 0.0, 0.3], 0.2), "right": ([-1.0, 0.0, 0.3], 0.25)}


@pytest.fixture
def capture(tmp_path):
    def make(carries, *lasers):
        folder = tmp_path / "_".join(lasers)
        folder.mkdir()
        tables = "".join(f'[[laser]]\nname = "{name}"\ncolour = "red"\n' for name in lasers)
        (folder / "capture.toml").write_text(
            'format = "jaxscan-capture/1"\nkind = "sweep"\n[camera]\nwidth = 320\nheight = 256\n'
            f'pixel_format = "mono8"\n[turntable]\ncarries = "{carries}"\n{tables}'
        )
        cv2.imwrite(str(folder / "a.png"), np.zeros((256, 320), np.uint8))
        (folder / "frames.jsonl").write_text('{"i": 0, "angle_deg": 0.0, "on": "a.png"}\n')
        return open_capture(folder)

    return make


def written(path, carries, *lasers):
    camera = {"model": "pinhole", "width": 320, "height": 256, "fx": 300, "fy": 300, "cx": 160, "cy": 128}
    camera["distortion"] = {"k1": 0, "k2": 0, "p1": 0, "p2": 0, "k3": 0}
    sheets = [{"name": name, "normal": PLANES[name][0], "distance_m": PLANES[name][1]} for name in lasers]
    table = {"direction": DIRECTION, "point_m": POINT, "carries": carries}
    content = {"format": "jaxscan-calibration/1", "camera": camera, "lasers": sheets, "turntable": table}
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("carries", ["scanner", "object"])
def test_an_axis_in_numbers_is_that_of_a_file(tmp_path, capture, carries):
    path = written(tmp_path / "c.json", carries, "left")
    numbers = [str(value) for value in POINT + DIRECTION]
    rig = capture(carries, "left")
    for words in (numbers, [str(path)]):
        motion = known_parts(rig, None, (), words, ())[0].motion
        expected = load_scanner(path).turntable
        np.testing.assert_allclose(motion.motion(np.array(0.3)), expected.motion(np.array(0.3)), atol=1e-6)
        assert motion.carries == carries


def test_an_axis_without_a_direction(capture):
    with pytest.raises(OptionError, match="--axis: direction"):
        known_parts(capture("scanner", "left"), None, (), ["0"] * 6, ())


def test_sheets_of_a_file_are_told_by_name(tmp_path, capture):
    path = written(tmp_path / "c.json", "scanner", "left", "right")
    sheets = known_parts(capture("scanner", "right", "left"), None, [str(path)], (), ())[0].sheets
    assert [round(float(sheet.normal[0]), 2) for sheet in sheets] == [-0.96, 0.96]
    with pytest.raises(OptionError, match="has the lasers left, right, the capture red, green"):
        known_parts(capture("scanner", "red", "green"), None, [str(path)], (), ())


def test_the_lens_decides_where_a_camera_file_names_no_model(tmp_path, capture):
    path = tmp_path / "camera.yaml"
    path.write_text("%YAML:1.0\nK: [300, 0, 160, 0, 300, 128, 0, 0, 1]\nD: [0.1, 0.01, 0.001, 0.0001]\n")
    rig = capture("scanner", "left")
    assert known_parts(rig, path, (), (), ())[0].camera.model == "pinhole"
    assert known_parts(rig, path, (), (), (), "fisheye")[0].camera.model == "fisheye"
    with pytest.raises(OptionError, match=r"--lens double_sphere: .* holds a pinhole camera"):
        known_parts(rig, path, (), (), (), "double_sphere")
