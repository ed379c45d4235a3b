"""Calibration files: exact to the last bit, and every wrong number named."""

import dataclasses
import json
import math
import os
from functools import partial

import jax
import numpy as np
import pytest

from jaxscan.calibration import (
    Calibration,
    ModelTest,
    Quality,
    SecondLook,
    Verdict,
    ViewQuality,
)
from jaxscan.calibration.result import DepthSigma, Direction, GoodTo, LaserLengths, Lengths, LengthSigma, PriorShare
from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import (
    calibration_digest,
    calibration_notes,
    check_calibration_path,
    load_calibration,
    load_scanner,
    save_calibration,
)
from jaxscan.files.calibration.calibration import quality_table, read_quality
from jaxscan.geometry import (
    Charuco,
    Chessboard,
    DoubleSphere,
    Fisheye,
    LaserSheet,
    Pinhole,
    Scanner,
    Turntable,
    point_up,
    stack_lasers,
)
from jaxscan.observation import BoardViews, Observations, StripeViews

from .conftest import refused


QUALITY = Quality(
    converged=True,
    corner_rms_px=float(np.float64(1.01) / 3),
    views=2,
    views_dropped=(7,),
    per_view=(ViewQuality(record=4, corners=12, corner_rms_px=0.1), ViewQuality(record=7, dropped=True)),
    unobserved=({"c1": 0.9, "s1": -0.4},),
    spectrum=(Direction(0.9, {"c1": 0.9, "s1": -0.4}),),
    prior_share=PriorShare(cost=0.01, information=0.8),
    prior_residuals={"fx/fy": -0.3},
    board_warp_m=(1e-4, -2e-4),
    warnings=("the lamp was on",),
    lengths=Lengths(
        (LaserLengths("red", (DepthSigma(1.0, 900, 0.1, 0.2, 0.3),), (LengthSigma("a", 2.5, 0.3, 0.05),)),)
    ),
    verdict=Verdict(
        False,
        GoodTo(2.0, 0.5, 2.5, 0.3, 0.2),
        "1 mm were asked",
        0.5,
        0.001,
        (ModelTest("lens", 90.0, 20, 0.1, 1e-9, 0.3, 2.0, "in the corners"),),
        ("Look at the lens.",),
    ),
    redetected=SecondLook(True, views_gained=1, corner_rms_whitened_before=1.1),
)
"""Something of every kind that a file can hold."""


def make_scanner(*, coefficients=5, lasers=("red", "green")):
    rng = np.random.default_rng(5)
    # Four coefficients make a fisheye, two a double sphere.
    camera = {4: Fisheye, 2: DoubleSphere}.get(coefficients, Pinhole)(
        fx=np.asarray(1234.567 + 1 / 3),
        fy=np.asarray(1234.1),
        cx=np.asarray(640.2),
        cy=np.asarray(511.9),
        distortion=rng.normal(scale=0.1, size=coefficients),
        width=1280,
        height=1024,
    )
    sheets = []
    for k in range(len(lasers)):
        flat = LaserSheet.from_plane(np.array([1.0, 0.01 + 0.1 * k, 0.2]), 0.25 + 0.1 * k)
        sheets.append(dataclasses.replace(flat, bow=rng.normal(scale=1e-4, size=2)))
    table = Turntable.from_axis(np.array([-0.018, -0.9998, -0.0008]), np.array([-0.01, 0.1, -0.2]), gain=-1.0001)
    table = dataclasses.replace(point_up(table, "-v"), harmonics=rng.normal(scale=1e-4, size=4))
    scanner = Scanner(camera, stack_lasers(sheets), table, laser_names=tuple(lasers))
    count = len(scanner.parameter_names())
    factor = rng.normal(size=(count, count)) * np.logspace(-6, 0, count)[:, None]
    factor[4] = 0  # A parameter held fixed.
    return dataclasses.replace(scanner, covariance=factor @ factor.T)


def make_observations(board=None):
    board = Charuco(columns=4, rows=3, square=0.03, marker=0.022) if board is None else board
    rng, corners = np.random.default_rng(6), len(board.corners())
    return Observations(
        board=board,
        corners=BoardViews(
            q=rng.uniform(0, 1000, (3, corners, 2)),
            sigma=rng.uniform(0.1, 1, (3, corners)),
            valid=rng.random((3, corners)) < 0.8,
            angle=np.array([0.0, 0.1, 0.2]),
            placement=np.array([0, 0, 1]),
            record=np.array([4, 5, 9]),
        ),
        stripes=StripeViews(
            q=rng.uniform(0, 1000, (2, 7, 2)),
            sigma=rng.uniform(0.1, 1, (2, 7)),
            valid=rng.random((2, 7)) < 0.8,
            view=np.array([0, 2], np.int32),
            laser=np.array([0, 1], np.int32),
        ),
        width=1280,
        height=1024,
        laser_names=("red", "green"),
    )


def make_calibration(scanner=None, **keys):
    scanner = make_scanner() if scanner is None else scanner
    return Calibration(
        camera=scanner.camera,
        scanner=scanner,
        order=scanner.parameter_names(),
        covariance=scanner.covariance,
        quality=QUALITY,
        provenance={"inputs": ["sha256:00"]},
        **keys,
    )


def camera_alone(coefficients=5):
    scanner = make_scanner(coefficients=coefficients)
    names = scanner.camera.parameter_names()
    covariance = np.diag(np.arange(1.0, 1 + len(names)))
    return Calibration(camera=scanner.camera, scanner=None, order=names, covariance=covariance)


def same_bits(a, b):
    """Equal structure, types and values, to the last bit of every float."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for one, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert type(one) is type(other)
        assert np.asarray(one).dtype == np.asarray(other).dtype
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()


@pytest.mark.parametrize("coefficients", [2, 4, 5, 8])
@pytest.mark.parametrize("lasers", [("red",), ("red", "green")])
def test_exact_to_the_last_bit(tmp_path, coefficients, lasers):
    calibration = make_calibration(make_scanner(coefficients=coefficients, lasers=lasers))
    save_calibration(calibration, tmp_path / "c.json")
    scanner = load_scanner(tmp_path / "c.json")
    same_bits(scanner, calibration.scanner)
    for leaf in jax.tree.leaves(scanner):
        assert isinstance(leaf, np.ndarray) and leaf.dtype == np.float64
    back = load_calibration(tmp_path / "c.json")
    same_bits(back.scanner, calibration.scanner)
    same_bits(back.camera, calibration.camera)
    assert back.covariance.tobytes() == calibration.covariance.tobytes()
    assert back.order == calibration.order and back.observations is None
    assert back.quality == QUALITY
    assert back.provenance == calibration.provenance


def test_what_is_saved_twice_is_the_same_file(tmp_path):
    save_calibration(make_calibration(), tmp_path / "a.json")
    save_calibration(load_calibration(tmp_path / "a.json"), tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert calibration_digest(tmp_path / "a.json") == calibration_digest(tmp_path / "b.json")
    assert calibration_digest(tmp_path / "a.json").startswith("sha256:")


def test_the_file_is_as_the_page_says(tmp_path):
    save_calibration(make_calibration(), tmp_path / "c.json")
    data = json.loads((tmp_path / "c.json").read_text())
    assert list(data) == ["format", "camera", "lasers", "turntable", "quality", "provenance", "covariance", "digests"]
    assert list(data["camera"])[:5] == ["model", "width", "height", "up", "fx"]
    assert list(data["camera"]["distortion"]) == ["k1", "k2", "p1", "p2", "k3"]
    assert set(data["lasers"][1]) == {"name", "normal", "distance_m", "bow", "basis"}
    assert set(data["turntable"]) == {"carries", "direction", "point_m", "gain", "harmonics", "basis"}
    assert data["covariance"]["order"][9:12] == ["laser.red.n1", "laser.red.n2", "laser.red.d"]
    # For people: a vector is a line.
    assert f'"normal": {data["lasers"][0]["normal"]}' in (tmp_path / "c.json").read_text()


def change_arrays(path, changes):
    """Arrays of an .npz replaced, or removed where the new one is None."""
    with np.load(path) as good:
        arrays = dict(good) | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


def without_digests(path):
    """The file as versions before wrote it, without digests."""
    data = json.loads(path.read_text())
    data.pop("digests", None)
    path.write_text(json.dumps(data))


@pytest.mark.parametrize("board", [None, Chessboard(columns=4, rows=3, square=0.1 / 3)])
def test_observations_come_back(tmp_path, board):
    calibration = make_calibration(observations=make_observations(board))
    save_calibration(calibration, tmp_path / "c.json")
    assert sorted(os.listdir(tmp_path)) == ["c.json", "c.npz"]
    same_bits(load_calibration(tmp_path / "c.json").observations, calibration.observations)
    # A reconstruction needs the JSON alone.
    (tmp_path / "c.npz").unlink()
    assert load_calibration(tmp_path / "c.json").observations is None
    same_bits(load_scanner(tmp_path / "c.json"), calibration.scanner)


def test_contrast_classes_come_back(tmp_path):
    observations = make_observations()
    classes = np.random.default_rng(0).integers(0, 6, observations.stripes.valid.shape).astype(np.int8)
    stripes = dataclasses.replace(observations.stripes, contrast=classes)
    calibration = make_calibration(observations=dataclasses.replace(observations, stripes=stripes))
    save_calibration(calibration, tmp_path / "c.json")
    same_bits(load_calibration(tmp_path / "c.json").observations, calibration.observations)
    without_digests(tmp_path / "c.json")
    # Points that are not valid too: every class is looked up.
    invalid = ~observations.stripes.valid
    assert invalid.any()
    for forged in (6, -1, 127):
        for where in (np.ones_like(classes, bool), invalid):
            change_arrays(tmp_path / "c.npz", {"stripes.contrast": np.where(where, forged, classes).astype(np.int8)})
            with pytest.raises(CalibrationError, match=r"stripes\.contrast: found an index outside 0 \.\.\. 5"):
                load_calibration(tmp_path / "c.json")


@pytest.mark.parametrize("coefficients", [2, 4, 5])
def test_a_camera_alone(tmp_path, coefficients):
    alone = camera_alone(coefficients)
    save_calibration(alone, tmp_path / "camera.json")
    back = load_calibration(tmp_path / "camera.json")
    assert back.scanner is None
    same_bits(back.camera, alone.camera)
    assert np.array_equal(back.covariance, alone.covariance)
    with pytest.raises(
        CalibrationError, match=r"camera\.json: holds a camera alone.*cannot reconstruct; calibrate with"
    ):
        load_scanner(tmp_path / "camera.json")


def test_observations_of_a_replaced_calibration_do_not_stay(tmp_path):
    save_calibration(make_calibration(observations=make_observations()), tmp_path / "c.json")
    save_calibration(make_calibration(), tmp_path / "c.json")
    assert os.listdir(tmp_path) == ["c.json"]


def test_a_foreign_npz_is_left_alone(tmp_path):
    np.savez(tmp_path / "c.npz", a=np.zeros(3))
    before = (tmp_path / "c.npz").read_bytes()
    save_calibration(make_calibration(), tmp_path / "c.json")
    assert load_calibration(tmp_path / "c.json").observations is None
    # A command asks before its work.
    observed = make_calibration(observations=make_observations())
    for refuse in (check_calibration_path, partial(save_calibration, observed)):
        with pytest.raises(CalibrationError, match=r"c\.npz: exists and holds no observations; choose another name"):
            refuse(tmp_path / "c.json")
    assert (tmp_path / "c.npz").read_bytes() == before
    with pytest.raises(CalibrationError, match=r"end its name in \.json"):
        save_calibration(make_calibration(), tmp_path / "c.npz")


def test_settings_that_json_cannot_hold_become_null(tmp_path):
    calibration = dataclasses.replace(
        make_calibration(), provenance={"prior": math.inf, "list": [np.float64("nan"), 1]}
    )
    save_calibration(calibration, tmp_path / "c.json")
    assert load_calibration(tmp_path / "c.json").provenance == {"prior": None, "list": [None, 1]}


def test_a_calibration_that_is_not_finite_is_not_written(tmp_path):
    scanner = make_scanner()
    broken = dataclasses.replace(scanner, camera=dataclasses.replace(scanner.camera, fx=np.asarray(np.nan)))
    with pytest.raises(CalibrationError, match=r"c\.json: cannot be written"):
        save_calibration(make_calibration(broken), tmp_path / "c.json")
    assert os.listdir(tmp_path) == []


def edit(data, path, value):
    *parents, last = path
    for key in parents:
        data = data[key]
    if value is KeyError:
        del data[last]
    else:
        data[last] = value


NAN = float("nan")


@pytest.mark.parametrize(
    ("coefficients", "path", "value", "message"),
    [
        (
            5,
            ["format"],
            "jaxscan-calibration/2",
            'format: found "jaxscan-calibration/2", expected "jaxscan-calibration/1"',
        ),
        (5, ["camera", "model"], "fisheye", "camera.distortion.p1: unknown key; the closest known one is"),
        (5, ["camera", "model"], "omni", 'camera.model: found "omni", expected "pinhole", "fisheye", "double_sphere"'),
        (5, ["camera", "fx"], NAN, "NaN"),
        (5, ["camera", "fx"], -5.0, "camera.fx: found -5.0, expected greater than or equal to 0.1"),
        (5, ["camera", "distortion", "k4"], 0.1, "camera.distortion: k4, k5 and k6 come together or not at all"),
        (5, ["lasers", 0, "distance_m"], -0.2, "lasers[0]: distance_m: found -0.2, expected greater than 0"),
        (5, ["lasers", 0, "basis", 1], [1.0, 0.0, 0.0], "lasers[0]: basis: expected two unit vectors, perpendicular"),
        (5, ["lasers", 1, "name"], "red", "lasers: found the names red, red"),
        (5, ["turntable", "direction"], [0.0, -1.0, 0.1], "turntable: direction: found a vector of length 1.00498"),
        (5, ["turntable", "point_m"], [0.0, 0.5, 0.0], "turntable: direction · point_m = -0.5, expected 0"),
        (5, ["turntable", "gain"], 0.0, "turntable: gain = 0"),
        # Without one of them it is a smaller rig, whose covariance has other parameters.
        (5, ["turntable"], KeyError, "covariance.order: found fx"),
        (5, ["camera", "up"], "+v", 'turntable.direction: points down, expected towards the image\'s up "+v"'),
        (5, ["covariance", "matrix", 0, 1], 1e9, "covariance: matrix: not symmetric"),
        (5, ["covariance", "matrix", 3, 3], -1.0, "covariance: matrix: the variance of cy is negative"),
        (5, ["covariance", "matrix", 4], [1.0], "covariance: matrix: expected 28 rows of 28 numbers"),
        (4, ["camera", "distortion", "k4"], KeyError, "camera.distortion.k4: missing"),
        (4, ["camera", "distortion", "k5"], 0.1, "camera.distortion.k5: unknown key"),
        (4, ["camera", "model"], "pinhole", "camera.distortion.p1: missing"),
        (4, ["covariance", "order", 4], "p1", "covariance.order: found fx, fy, cx, cy, p1"),
        (2, ["camera", "distortion", "xy"], 0.1, 'camera.distortion.xy: unknown key; the closest known one is "xi"'),
        (2, ["camera", "skew"], 0.5, "camera.skew: found 0.5, a double_sphere has no skew"),
    ],
)
def test_every_wrong_number_is_named(tmp_path, coefficients, path, value, message):
    save_calibration(make_calibration(make_scanner(coefficients=coefficients)), tmp_path / "c.json")
    data = json.loads((tmp_path / "c.json").read_text())
    names = {5: ["k1", "k2", "p1", "p2", "k3"], 4: ["k1", "k2", "k3", "k4"], 2: ["xi", "alpha"]}
    assert list(data["camera"]["distortion"]) == names[coefficients] and data["camera"]["skew"] == 0
    edit(data, path, value)
    (tmp_path / "c.json").write_text(json.dumps(data))
    for load in (load_scanner, load_calibration):
        refused(CalibrationError, partial(load, tmp_path / "c.json"), message, "c.json")


def test_a_covariance_that_is_none(tmp_path):
    calibration = make_calibration()
    scale = np.sqrt(np.diag(calibration.covariance))
    # Three variables cannot all be perfectly anticorrelated: symmetric, and yet no covariance.
    matrix = np.diag(np.diag(calibration.covariance))
    for a, b in ((0, 1), (0, 2), (1, 2)):
        matrix[a, b] = matrix[b, a] = -0.9 * scale[a] * scale[b]
    with pytest.raises(CalibrationError, match="not positive semidefinite"):
        save_calibration(dataclasses.replace(calibration, covariance=matrix), tmp_path / "c.json")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: not valid JSON"),
        ('{"format": 1,\n}', "line 2: not valid JSON"),
        ("[]", "found [], expected a table"),
        ("{}", "missing"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_what_is_no_calibration(tmp_path, text, message):
    (tmp_path / "c.json").write_text(text)
    refused(CalibrationError, lambda: load_scanner(tmp_path / "c.json"), message, "c.json")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("corners.q", np.zeros((3, 5, 2)), "corners.q: found float64 with shape (3, 5, 2)"),
        ("corners.sigma", np.full((3, 6), np.inf), "corners.sigma is not finite"),
        ("stripes.view", np.array([0, 3]), "stripes.view: found an index outside 0 ... 2"),
        ("stripes.laser", np.array([-1, 0]), "stripes.laser: found an index outside 0 ... 1"),
        ("stripes.q", None, "stripes.q is missing"),
        ("corners.q", np.full((3, 6, 2), 1e300), "corners.q: found a number outside"),
        ("stripes.sigma", np.full((2, 7), 1e-320), "stripes.sigma: found a number outside"),
    ],
)
def test_wrong_observations(tmp_path, name, value, message):
    save_calibration(make_calibration(observations=make_observations()), tmp_path / "c.json")
    without_digests(tmp_path / "c.json")
    change_arrays(tmp_path / "c.npz", {name: value})
    refused(CalibrationError, lambda: load_calibration(tmp_path / "c.json"), message, "c.npz")
    # The scanner itself is not touched by it.
    same_bits(load_scanner(tmp_path / "c.json"), make_scanner())


class TestQuality:
    def test_keys_are_those_of_the_fields(self):
        table = json.loads(json.dumps(quality_table(QUALITY)))
        assert table["per_view"][0]["corner_rms_px"] == 0.1 and table["views_dropped"] == [7]
        assert table["lengths"] == {
            "lasers": [
                {
                    "name": "red",
                    "depths": [
                        {"depth_m": 1.0, "lines": 900, "sigma_depth_mm": 0.1, "sigma_range_mm": 0.2}
                        | {"sigma_point_mm": 0.3}
                    ],
                    "lengths": [{"name": "a", "depth_m": 2.5, "length_m": 0.3, "sigma_mm": 0.05}],
                }
            ]
        }
        (test,) = table["verdict"]["tests"]
        assert list(test) == ["name", "statistic", "dof", "p", "p_structure", "effect_mm", "effect_px", "where"]
        # Nobody knows, so nothing is written; and of nothing at all an empty table.
        assert "seconds" not in table and "stripe_points_gained" not in table["redetected"]
        assert quality_table(Quality()) == {} and read_quality({}) == Quality()
        assert read_quality(table) == QUALITY

    @pytest.mark.parametrize(
        ("key", "value"),
        [
            ("converged", 1),
            ("views", 2.5),
            ("views", 10**400),
            ("corner_rms_px", "0.1"),
            ("corner_rms_px", float("1e400")),
            ("warnings", ["one", 2]),
            ("per_view", {"a": 1}),
            ("per_view", [{"record": "x"}]),
            ("spectrum", [{"sigma_over_prior": None, "direction": {}}]),
            ("prior_share", []),
            ("board_warp_m", ["a", "b"]),
            ("lengths", {"lasers": [{"name": "red", "depths": [{"depth_m": "far"}]}]}),
            ("verdict", {"usable": True, "good_to": {"sigma_mm": "small"}}),
            ("verdict", {"usable": True, "tests": [{"name": "lens", "p": 0.5}]}),
            ("redetected", {"kept": 1}),
        ],
    )
    def test_what_is_of_another_kind_counts_as_missing(self, key, value):
        """With its key alone: the rest is read."""
        assert read_quality({"placements": 3, key: value, "of a stranger": [1]}) == Quality(placements=3)

    def test_a_verdict_of_an_earlier_version_is_read_but_says_nothing_of_use(self):
        test = {"name": "lens", "statistic": 9.0, "dof": 3, "p": 0.1, "p_structure": 0.1, "effect_sigma": 2.0}
        verdict = read_quality({"verdict": {"accepted": False, "tests": [test], "advice": ["more"]}}).verdict
        assert verdict.usable is None and verdict.good_to is None
        assert verdict.tests[0].dof == 3 and verdict.advice == ("more",)

    def test_a_solve_that_did_not_converge_is_noted(self, tmp_path):
        path, found = tmp_path / "c.json", []
        for converged in (False, True, None):
            quality = dataclasses.replace(QUALITY, converged=converged)
            save_calibration(dataclasses.replace(make_calibration(), quality=quality), path)
            found.append(calibration_notes(path))
        assert "did not converge" in found[0][0] and found[1:] == [[], []]


@pytest.mark.parametrize("part", [0.0, 0.6, 0.99])
@pytest.mark.parametrize("old", [False, True])
def test_damaged_observations_are_never_taken_for_missing_ones(tmp_path, part, old):
    save_calibration(make_calibration(observations=make_observations()), tmp_path / "c.json")
    if old:
        without_digests(tmp_path / "c.json")
    good = (tmp_path / "c.npz").read_bytes()
    at = int(part * len(good))
    for damaged in (good[:at] + bytes(60) + good[at + 60 :], good[:at]):
        (tmp_path / "c.npz").write_bytes(damaged)
        with pytest.raises(CalibrationError, match=r"c\.npz: the observations .*damaged") as caught:
            load_calibration(tmp_path / "c.json")
        assert "\n" not in str(caught.value)
        load_scanner(tmp_path / "c.json")


HOSTILE = [1e308, -1e308, 1e-320, 5e-324, 1e160, -1e160, 1e-160]


def numbers(value, path=()):
    """Paths of all numbers of a JSON value that describe the scanner."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return [one for key, item in items for one in numbers(item, (*path, key))]
    return [path] if isinstance(value, float) else []


@pytest.mark.parametrize("by_hand", [False, True])
@pytest.mark.parametrize("hostile", HOSTILE)
def test_hostile_numbers_are_refused_or_harmless(tmp_path, hostile, by_hand):
    """Warnings are errors here, so neither may a square overflow nor a division by nearly nothing pass."""
    save_calibration(make_calibration(), tmp_path / "c.json")
    good = json.loads((tmp_path / "c.json").read_text())
    good.pop("digests", None)
    if by_hand:
        for table in (*good["lasers"], good["turntable"]):
            del table["basis"]
        del good["covariance"]
    parts = {key: good[key] for key in ("camera", "lasers", "turntable", "covariance") if key in good}
    every = numbers(parts)
    for path in every if len(every) < 100 else every[:60] + every[60::37]:
        data = json.loads(json.dumps(good))
        edit(data, list(path), hostile)
        (tmp_path / "d.json").write_text(json.dumps(data))
        try:
            scanner = load_scanner(tmp_path / "d.json")
        except CalibrationError as problem:
            assert "\n" not in str(problem)
            continue
        single = scanner.as_dtype(np.float32)
        assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(single)), path
        assert float(np.asarray(single.lasers.distance).min()) > 0
