"""Calibrations written by hand: read as they are meant, normalised, and every mistake named."""

import dataclasses
import json
import math
import re
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxscan.errors import CalibrationError
from jaxscan.files import load_calibration, load_scanner, save_calibration, save_scanner
from jaxscan.files.calibration import calibration_notes
from jaxscan.geometry import LaserSheet, LinearStage, Pinhole, Scanner, Still, Turntable

from .conftest import refused
from .test_calibration import edit


GUIDE = Path(__file__).resolve().parents[2] / "docs" / "captures.md"


@pytest.fixture
def by_hand(tmp_path):
    """Writes a calibration as people do: the file of the guide, changed where a test wants."""

    def write(*changes):
        (text,) = re.findall(r"```json\n(.*?)```", GUIDE.read_text(), re.DOTALL)
        assert len(text.splitlines()) <= 12
        data = json.loads(text)
        for path, value in changes:
            edit(data, path, value)
        (tmp_path / "hand.json").write_text(json.dumps(data))
        return tmp_path / "hand.json"

    return write


def points_of(scanner):
    seen = [([1200.0, 800.0], 0.0), ([1150.0, 1600.0], 1.3), ([1300.0, 40.0], -2.0)]
    found = [scanner.point(np.array(q), 0, np.asarray(phi)) for q, phi in seen]
    assert all(incidence > 0 for _, incidence in found)
    return np.array([point for point, _ in found])


def test_the_file_of_the_guide(by_hand, tmp_path):
    scanner = load_scanner(by_hand())
    # The paper's plane: -7.606 X - 1.685 Y + Z = 1.296203 in the camera frame.
    n, d = np.array([7.606, 1.685, -1.0]), -1.296203
    sheet = scanner.laser(0)
    np.testing.assert_allclose(sheet.normal, -n / np.linalg.norm(n), rtol=1e-15)
    np.testing.assert_allclose(sheet.distance, -d / np.linalg.norm(n), rtol=1e-15)
    # The design's point of the paper's rig; the axis is written with six digits, and the point is 2.7 m away from it.
    np.testing.assert_allclose(points_of(scanner)[0], [2.663958, -0.165195, 0.009750], atol=3e-6)
    assert scanner.covariance is None and scanner.laser_names == ("laser",)
    save_calibration(load_calibration(by_hand()), tmp_path / "canonical.json")
    canonical = json.loads((tmp_path / "canonical.json").read_text())
    assert set(canonical["lasers"][0]) == {"name", "normal", "distance_m", "bow", "basis"}
    again = load_scanner(tmp_path / "canonical.json")
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(scanner), strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()


@pytest.mark.parametrize("known", [False, True])
def test_a_scanner_from_parts_is_saved_and_read(tmp_path, known):
    camera = Pinhole(*map(np.float64, (410.0, 411.0, 319.5, 255.5)), np.zeros(5), 640, 512, np.float64(0.0))
    sheets = [LaserSheet.from_plane([0.99, 0.0, 0.14], 0.44), LaserSheet.from_plane([0.98, 0.0, -0.2], 0.4)]
    scanner = Scanner.from_parts(camera, sheets, Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.05]))
    if known:
        covariance = np.diag(np.linspace(1e-8, 1e-6, len(scanner.parameter_names())))
        scanner = dataclasses.replace(scanner, covariance=covariance)
    save_scanner(scanner, tmp_path / "made.json")
    again = load_scanner(tmp_path / "made.json")
    assert again.laser_names == ("laser1", "laser2") and (again.covariance is not None) == known
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(scanner), strict=True):
        # Unit vectors are normalised on reading.
        np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-16)


def test_a_scanner_is_no_calibration(by_hand, tmp_path):
    scanner = load_scanner(by_hand())
    with pytest.raises(CalibrationError, match=r"found a Scanner, expected a Calibration; save_scanner") as raised:
        save_calibration(scanner, tmp_path / "c.json")
    assert "\n" not in str(raised.value)
    with pytest.raises(CalibrationError, match=r"found a str, expected a Calibration\.$"):
        save_calibration("calibration", tmp_path / "c.json")
    with pytest.raises(CalibrationError, match="found a Calibration, expected a Scanner"):
        save_scanner(load_calibration(by_hand()), tmp_path / "c.json")
    assert not (tmp_path / "c.json").exists()


def test_that_it_counts_as_exact_is_said(by_hand):
    (note,) = calibration_notes(by_hand())
    assert "has no covariance, so it counts as exact" in note


@pytest.mark.parametrize("factor", [-1.0, 3.0, -1e-3])
def test_a_normal_of_any_length_and_sign(by_hand, factor):
    expected = points_of(load_scanner(by_hand()))
    n, d = np.array([-7.606, -1.685, 1.0]) * factor, 1.296203 * factor
    laser = {"normal": n.tolist(), "distance_m": d}
    # Rounding in double precision, of points a few metres away.
    np.testing.assert_allclose(points_of(load_scanner(by_hand((["lasers", 0], laser)))), expected, atol=1e-12)


@pytest.mark.parametrize(("factor", "along"), [(1.0, 0.7), (-1.0, 0.0), (-20.0, -3.0)])
def test_any_point_of_the_axis_and_a_direction_of_either_sense(by_hand, factor, along):
    path = by_hand()
    table, expected = json.loads(path.read_text())["turntable"], load_scanner(path)
    direction = np.array(table["direction"])
    changed = {
        "direction": (factor * direction).tolist(),
        "point_m": (np.array(table["point_m"]) + along * direction).tolist(),
        # The same table counts the other way about an axis of the other sense.
        "gain": math.copysign(1.0, factor),
        "harmonics": (math.copysign(1.0, factor) * np.array([1e-3, 2e-3, -3e-4, 5e-4])).tolist(),
    }
    harmonics = np.array([1e-3, 2e-3, -3e-4, 5e-4])
    expected = dataclasses.replace(expected, turntable=dataclasses.replace(expected.turntable, harmonics=harmonics))
    found = load_scanner(by_hand((["turntable"], changed)))
    np.testing.assert_allclose(points_of(found), points_of(expected), atol=1e-12)
    assert found.turntable.direction[1] < 0 and found.turntable.gain == 1.0


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["lasers", 0, "abc"], [-7.6, -1.7], "lasers[0].abc[2]: missing"),
        (["lasers", 0, "abc"], [-7.6, -1.7, 0.0], "lasers[0]: distance: found 0 m, expected a plane"),
        (["lasers", 0, "normal"], [1.0, 0.0, 0.0], "lasers[0]: abc: found beside normal"),
        (["lasers", 0], {"normal": [1.0, 0.0, 0.0]}, "lasers[0]: distance_m: missing"),
        (["lasers", 0, "bow"], [1e-4, 0.0], "lasers[0]: bow: its signs and its size refer to a normal"),
        (["turntable", "direction"], [0.0, 0.0, 0.0], "turntable: direction: found [0.0, 0.0, 0.0]"),
        (["turntable", "point_m"], KeyError, "turntable.point_m: missing"),
        (["turntable"], {"carries": "linear", "direction": [0, 0, 0]}, "turntable: direction: found [0.0, 0.0, 0.0]"),
        (["turntable"], {"carries": "linear", "direction": [1, 0, 0], "gain": 0}, "turntable: gain = 0"),
        (
            ["turntable"],
            {"carries": "linear", "direction": [1, 0, 0], "point_m": [0, 0, 0]},
            "turntable.point_m: unknown key",
        ),
        (["covariance"], {"order": [], "matrix": []}, "covariance: refers to the basis of every laser"),
    ],
)
def test_what_is_wrong_is_said(by_hand, path, value, message):
    for load in (load_scanner, load_calibration):
        refused(CalibrationError, partial(load, by_hand((path, value))), message, "hand.json")


def test_a_profile_scanner(by_hand, tmp_path):
    still = (["turntable"], KeyError)
    scanner = load_scanner(by_hand(still))
    assert isinstance(scanner.turntable, Still)
    point, incidence = scanner.point(np.array([1200.0, 800.0]), 0, np.asarray(0.0))
    assert incidence > 0
    # The design's point of the paper's rig, camera frame.
    np.testing.assert_allclose(point, [0.155163, -0.014657, 2.451674], atol=2e-6)
    save_calibration(load_calibration(by_hand(still)), tmp_path / "again.json")
    assert "turntable" not in json.loads((tmp_path / "again.json").read_text())
    assert isinstance(load_scanner(tmp_path / "again.json").turntable, Still)


def test_a_linear_stage(by_hand, tmp_path):
    table = {"carries": "linear", "direction": [0.0, 3.0, 4.0]}
    scanner = load_scanner(by_hand((["turntable"], table)))
    stage = scanner.turntable
    assert isinstance(stage, LinearStage)
    np.testing.assert_allclose(stage.direction, [0.0, 0.6, 0.8], atol=1e-15)
    still, moved = (scanner.point(np.array([1200.0, 800.0]), 0, np.asarray(s))[0] for s in (0.0, 0.5))
    np.testing.assert_allclose(moved - still, [0.0, 0.3, 0.4], atol=1e-12)
    # A stage that counts the other way.
    path = by_hand((["turntable"], table | {"gain": -1.0}))
    back = load_scanner(path).turntable
    np.testing.assert_allclose(back.direction, [0.0, -0.6, -0.8], atol=1e-15)
    save_calibration(load_calibration(path), tmp_path / "again.json")
    again = load_scanner(tmp_path / "again.json").turntable
    assert np.asarray(again.direction).tobytes() == np.asarray(back.direction).tobytes()


def test_parts_that_cannot_reconstruct(by_hand):
    alone, with_axis = [(["lasers"], KeyError), (["turntable"], KeyError)], [(["lasers"], KeyError)]
    for changes, words in ((alone, "holds a camera alone"), (with_axis, "holds camera and axis")):
        path = by_hand(*changes)
        refused(CalibrationError, partial(load_scanner, path), f"{words}, without a laser sheet, so it cannot")
        assert load_calibration(path).camera.width == 2048
