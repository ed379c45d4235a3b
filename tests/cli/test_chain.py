"""The whole way on the command line: simulate, calibrate, reconstruct, measure, convert."""

import json
from unittest.mock import create_autospec

import numpy as np
import pytest

import jaxscan


UNITS = ("_m", "_mm", "_px", "_deg", "_s")


@pytest.mark.parametrize("verb", ["simulate", "calibrate", "reconstruct", "measure-room", "measure-compare"])
def test_json_says_first_what_it_is(tiny, verb):
    result = tiny.results[verb]
    assert next(iter(result)) == "format"
    assert result["format"] == f"jaxscan-{verb}/1"


def test_what_simulate_says(tiny):
    result = tiny.results["simulate"]
    assert result["board_pairs"] == 12 + 3 * 3
    assert result["sweep_pairs"] == 60
    assert 0 < result["seconds_s"] < 600
    for key in ("boards", "sweep", "truth", "true_cloud"):
        assert (tiny.folder / result[key]).exists()


def test_the_calibration_is_that_of_the_rig(tiny):
    """Against the configuration, of which calibrate knows nothing."""
    scanner = jaxscan.load_scanner(tiny.calibration)
    truth = {"fx": 215.0, "fy": 215.2, "cx": 161.2, "cy": 127.1}
    order, sigma = scanner.parameter_names(), np.sqrt(np.diag(scanner.covariance))
    # Six predicted standard deviations: chance alone exceeds this once in 500 million.
    for name, true in truth.items():
        assert abs(float(getattr(scanner.camera, name)) - true) < 6 * sigma[order.index(name)]
    quality = tiny.results["calibrate"]["quality"]
    assert quality["views"] == 21
    # Corners of a rendered chessboard are good to a tenth of a pixel at this size.
    assert 0.0 < quality["corner_rms_px"] < 0.15
    assert 0.0 < quality["stripe_rms_px"] < 0.25


def test_the_cloud_is_that_of_the_room(tiny):
    reconstructed, compared = tiny.results["reconstruct"], tiny.results["measure-compare"]
    assert reconstructed["records"] == 60
    assert reconstructed["points"] == int(jaxscan.load_cloud(tiny.cloud).valid.sum())
    assert reconstructed["notes"] == []
    assert compared["completeness"] > 0.98
    # 0.1 px of stripe noise at 2.5 m are 7 mm with this baseline and focal length.
    assert 0 < reconstructed["median_sigma_random_m"] < 0.007
    assert 0 < reconstructed["median_sigma_systematic_m"] < 0.01
    assert 0 < compared["error_m"]["rms"] < 0.01
    # Predicted and actual noise agree; systematic errors are shared, so this is no exact 1.
    assert 0.5 < compared["whitened"]["rms"] < 2.0


def test_the_room_is_as_large_as_it_is(tiny):
    result = tiny.results["measure-room"]
    for name, true_m in (("length", 3.8), ("width", 3.2)):
        side = result[name]
        # Four predicted standard deviations: chance alone exceeds this once in 16000.
        assert abs(side["value_m"] - true_m) < 4 * side["sigma_m"]
        assert 0 < side["sigma_m"] < 0.01


@pytest.mark.more
def test_every_nth_record(tiny, run, refused, tmp_path):
    sparse = tmp_path / "a.npz"
    ran = run("reconstruct", tiny.sweep, "-c", tiny.calibration, "-o", sparse, "--every", 3, "--json", "-")
    assert ran.code == 0
    assert json.loads(ran.out)["records"] == 20
    cloud, whole = jaxscan.load_cloud(sparse), jaxscan.load_cloud(tiny.cloud)
    np.testing.assert_allclose(cloud.angle, np.deg2rad(np.arange(0.0, 360.0, 18.0)), atol=1e-12)
    # The noise is estimated from other records, so a few cells may be judged otherwise.
    both = cloud.valid & whole.valid[::3]
    assert both.sum() > 0.98 * cloud.valid.sum()
    # Sparse turns are refused rather than measured: points of one profile lie on a plane of light
    # wherever they are; that is no wall.
    assert "No two opposite walls" in refused("measure", "room", sparse)


@pytest.mark.parametrize("suffix", [".ply", ".npz", ".xyz", ".pcd", ".ptx"])
def test_convert(tiny, run, tmp_path, suffix):
    target = tmp_path / f"room{suffix}"
    ran = run("convert", tiny.cloud, target, "--json", "-")
    assert ran.code == 0
    result = json.loads(ran.out)
    assert result["format"] == "jaxscan-convert/1"
    assert result["points"] == tiny.results["reconstruct"]["points"]
    assert target.stat().st_size > 12 * result["points"] / 2
    if suffix in (".ply", ".npz"):
        again, cloud = jaxscan.load_cloud(target), jaxscan.load_cloud(tiny.cloud)
        np.testing.assert_array_equal(again.valid, cloud.valid)
        np.testing.assert_array_equal(again.xyz[again.valid], cloud.xyz[cloud.valid])


def test_measure_distance_and_plane(tiny, run):
    cloud = jaxscan.load_cloud(tiny.cloud)
    middle = cloud.xyz.shape[1] // 2
    away = np.where(cloud.valid[:, middle], np.linalg.norm(cloud.xyz[:, middle], axis=-1), np.inf)
    # The nearest point lies in the middle of a wall, and another opposite to it.
    a, b = (cloud.xyz[(away.argmin() + k) % 60, middle] for k in (0, 30))
    ran = run("measure", "distance", tiny.cloud, "--a", *a, "--b", *b, "--radius-mm", 150, "--json", "-")
    assert ran.code == 0, ran.err
    result = json.loads(ran.out)
    assert result["format"] == "jaxscan-measure-distance/1"
    # The patches are averaged around the picked points, so they lie within a fraction of the radius.
    assert result["value_m"] == pytest.approx(np.linalg.norm(a - b), abs=0.1)
    ran = run("measure", "plane", tiny.cloud, "--at", *a, "--json", "-")
    assert ran.code == 0, ran.err
    result = json.loads(ran.out)
    assert result["format"] == "jaxscan-measure-plane/1"
    assert 0 < result["rms_m"] < 0.01
    assert result["points"] > 20


def test_results_have_units_in_their_keys(tiny):
    """Every length that is no count, share or name says its unit."""

    def unnamed(value, key=""):
        if isinstance(value, dict):
            inside = {"error_m", "along_ray_m", "whitened", "quality"} & {key}
            return [] if inside else [found for k, v in value.items() for found in unnamed(v, k)]
        return [key] if isinstance(value, float) and not key.endswith(UNITS) else []

    for verb, result in tiny.results.items():
        assert set(unnamed(result)) <= {"completeness"}, verb


def test_camera_alone(tiny, run, refused, tmp_path):
    target = tmp_path / "camera.json"
    ran = run("calibrate", tiny.boards, "-o", target, "--only", "camera")
    assert ran.code == 0, ran.err
    assert jaxscan.load_calibration(target).scanner is None
    message = refused("reconstruct", tiny.sweep, "-c", target, "-o", tmp_path / "a.ply")
    assert "holds a camera alone" in message and "calibrate with a capture" in message
    assert not (tmp_path / "a.ply").exists()


@pytest.mark.parametrize(
    "calibrates", [pytest.param(False, marks=pytest.mark.more), pytest.param(True, marks=pytest.mark.slow)]
)
def test_demo_of_a_tiny_rig(tiny, run, tmp_path, monkeypatch, calibrates):
    """The demo's own way, on the captures that are there already, and with the calibration that is."""
    from jaxscan import api
    from jaxscan.cli import demo

    output = tmp_path / "demo"
    output.mkdir()
    (output / "captures").symlink_to(tiny.boards.parent)
    monkeypatch.setattr(demo.api, "load_simulation", lambda path: api.load_toml(tiny.config, api.SimulationConfig))
    if not calibrates:
        known = create_autospec(api.calibrate, return_value=jaxscan.load_calibration(tiny.calibration))
        monkeypatch.setattr(demo.api, "calibrate", known)
    ran = run("demo", "-o", output, "--json", "-")
    assert ran.code == 0, ran.err
    result = json.loads(ran.out)
    assert result["format"] == "jaxscan-demo/1"
    assert {entry["name"] for entry in result["room"]} >= {"length", "width"}
    for entry in result["room"]:
        assert abs(entry["error_m"]) == pytest.approx(abs(entry["measured_m"] - entry["truth_m"]))
        assert abs(entry["error_m"]) < 4 * entry["predicted_sigma_m"]
    assert all((output / name).stat().st_size > 0 for name in ("calibration.json", "room.ply", "room.png"))
