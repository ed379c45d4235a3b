"""A fisheye and a double sphere the whole way on the command line: rendered boards and room, calibration, cloud."""

import json

import numpy as np
import pytest

import jaxscan
from jaxscan.cli.main import main
from jaxscan.geometry import CAMERAS


RIG = """
seed = 1
[camera]
width = 480
height = 480
cx = 240.6
cy = 238.6
field_deg = 195.0
LENS
[sensor]
psf_px = 0.8
[laser]
baseline_m = 0.30
crossing_m = 3.0
origin_m = [0.31, 0.0, -0.10]
fan_deg = 175.0
waist_mm = 1.0
peak_dn = 90.0
[turntable]
direction = [0.0, -1.0, 0.0]
point_m = [0.1, 0.0, -0.05]
[room]
size_m = [3.82, 4.60, 2.5]
rig_m = [1.85, 2.2, 1.2]
furniture = false
[boards]
type = "chessboard"
columns = 7
rows = 5
square_mm = 60.0
free_views = 12
placements = 2
angles = 3
range_m = [0.25, 0.50]
[plan]
steps = 48
"""


LENSES = {
    "fisheye": "fx = 145.5\nfy = 145.6\nk1 = -0.02\nk2 = 0.003\nk3 = -0.001\nk4 = 0.0001",
    "double_sphere": "fx = 112.0\nfy = 112.1\nxi = -0.18\nalpha = 0.58",
}


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("model", LENSES)
def test_a_room_in_one_turn_with_floor_and_ceiling(tmp_path, monkeypatch, model):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "rig.toml").write_text(RIG.replace("LENS", f'model = "{model}"\n{LENSES[model]}'))
    captures, calibration, cloud = tmp_path / "captures", tmp_path / "calibration.json", tmp_path / "room.ply"
    verbs = {
        "simulate": [tmp_path / "rig.toml", "-o", captures],
        "calibrate": [captures / "boards", "-o", calibration, "--lens", model],
        "reconstruct": [captures / "sweep", "-c", calibration, "-o", cloud],
        "measure-room": [cloud, "-c", calibration],
        "measure-compare": [cloud, captures / "truth.npz", "-c", calibration],
    }
    results = {}
    for verb, words in verbs.items():
        target = tmp_path / f"{verb}.json"
        assert main([*verb.split("-"), *map(str, words), "--json", str(target)]) == 0, verb
        results[verb] = json.loads(target.read_text())
    scanner = jaxscan.load_scanner(calibration)
    assert isinstance(scanner.camera, CAMERAS[model])
    truth = json.loads((captures / "truth.json").read_text())["parameters"]
    order, sigma = scanner.parameter_names(), np.sqrt(np.diag(scanner.covariance))
    values = dict(zip(order, np.asarray(scanner.camera.parameters()), strict=False))
    for name, value in values.items():
        # Six predicted standard deviations, and the bias of detected corners (0.02 px of 200 px).
        bias = 0.02 if name in ("fx", "fy", "cx", "cy") else 1e-4
        assert abs(value - truth[name]) < 6 * sigma[order.index(name)] + bias, name
    compared, found = results["measure-compare"], results["measure-room"]
    assert compared["completeness"] > 0.97
    # 0.1 px of stripe noise are 0.7 mrad, which is 4 mm at 1.3 m with this baseline.
    assert compared["error_m"]["median_abs"] < 0.005
    # Five predicted standard deviations: chance alone exceeds this once in a million. So few steps
    # leave the walls too sparse to be told from planes of light.
    assert abs(found["height"]["value_m"] - 2.5) < 5 * found["height"]["sigma_m"]
    assert found["height"]["sigma_m"] < 0.002
    # Seen from one place, the cloud reaches straight up and down: the lens sees beside itself.
    xyz = np.asarray(jaxscan.load_cloud(cloud).xyz).reshape(-1, 3)
    xyz = xyz[(xyz != 0).any(-1)]
    steep = np.degrees(np.arctan2(np.abs(xyz[:, 2]), np.hypot(xyz[:, 0], xyz[:, 1])))
    assert steep.max() > 80
