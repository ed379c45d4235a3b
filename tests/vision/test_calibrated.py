"""From pictures of other boards to a camera, the whole way: import, corners, solve, files."""

import json

import cv2
import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.files import load_calibration

from .printed import CAMERA, LENS, picture
from .test_other_boards import APRIL, CIRCLES, PER_SQUARE, poses, texture


WORDS = {CIRCLES: "circles 4x11 20mm 18mm", APRIL: "aprilgrid 5x4 35mm 10.5mm"}


@pytest.mark.slow
@pytest.mark.parametrize("board", [CIRCLES, APRIL], ids=["circles", "aprilgrid"])
def test_a_strangers_boards_calibrate_a_camera(board, tmp_path, capsys):
    (tmp_path / "in").mkdir()
    for k, motion in enumerate(poses(board)):
        cv2.imwrite(str(tmp_path / "in" / f"v{k}.png"), picture(board, texture(board), PER_SQUARE[board], motion, k))
    assert main(["import", str(tmp_path / "in"), "-o", str(tmp_path / "boards"), "--board", WORDS[board]]) == 0
    words = ["calibrate", str(tmp_path / "boards"), "-o", str(tmp_path / "c.json"), "--only", "camera"]
    # Whatever the verdict says, the file is written.
    assert main([*words, "--json", str(tmp_path / "r.json")]) in (0, 1)
    capsys.readouterr()
    found = load_calibration(tmp_path / "c.json")
    assert found.observations is not None and found.observations.board == board
    camera = found.camera
    true = {"fx": CAMERA[0, 0], "fy": CAMERA[1, 1], "cx": CAMERA[0, 2], "cy": CAMERA[1, 2], "k1": LENS[0]}
    given = json.loads((tmp_path / "c.json").read_text())
    sigma = np.sqrt(np.diag(given["covariance"]["matrix"]))
    names = given["covariance"]["order"]
    values = {**{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}}
    values["k1"] = given["camera"]["distortion"]["k1"]
    for name, value in values.items():
        limit = 5.0 * sigma[next(at for at, one in enumerate(names) if one.rpartition(".")[2] == name)]
        # Edges are drawn to a quarter of a pixel, which is no noise of which the solve knows.
        assert abs(value - true[name]) < max(limit, 0.003 if name == "k1" else 0.5), name
