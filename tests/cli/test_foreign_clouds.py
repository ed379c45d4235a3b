"""Clouds that went through another program, in another unit or frame, or on a map: measured and converted."""

import json

import numpy as np
import pytest

import jaxscan
from jaxscan.files.clouds import read_cloud

from ..files.clouds import make_cloud
from ..files.strangers import LEVEL, RGB, STRANGERS, XYZ
from ..files.test_cloud_exchange import as_another_program, room


def measured(run, *words):
    ran = run("measure", "room", *words, "--json", "-")
    assert ran.code == 0, ran
    assert "nan" not in ran.out + ran.err.lower().replace("nanoseconds", "")
    return json.loads(ran.out)


def test_a_cloud_that_lost_its_angles_is_not_measured_with_a_calibration(tiny, refused, tmp_path):
    """Angle 0 for all points: their sigma was 29 mm, or no number, with exit code 0."""
    cloud = jaxscan.load_cloud(tiny.cloud)
    lost = as_another_program(cloud, tmp_path / "a.ply", drop=["scalar_step", "scalar_angle", "scalar_laser"])
    for words in ((), ("--json", "-")):
        message = refused("measure", "room", lost, "-c", tiny.calibration, "--up", "z", *words)
        assert "are not where the calibration's laser lights them" in message and "without the calibration" in message


def test_a_cloud_that_kept_its_columns_is_measured_as_ours(tiny, run, tmp_path):
    cloud = jaxscan.load_cloud(tiny.cloud)
    kept = as_another_program(cloud, tmp_path / "a.ply")
    ours = measured(run, tiny.cloud, "-c", tiny.calibration)
    back = measured(run, kept, "-c", tiny.calibration, "--up", "z")
    for side in ("length", "width"):
        # The same points in the same grid; angles are in single precision.
        assert back[side]["value_m"] == pytest.approx(ours[side]["value_m"], abs=1e-6)
        assert back[side]["sigma_m"] == pytest.approx(ours[side]["sigma_m"], rel=1e-3)


def foreign(path, cloud, *, factor=1.0, turn=None):
    """Points alone, as a text of another program."""
    xyz = cloud.xyz[cloud.valid].astype(float) * factor
    np.savetxt(path, xyz if turn is None else xyz @ np.array(turn).T, fmt="%.9f")
    return path


SIZE = {"length": 5.0, "width": 4.0, "height": 2.6}
Y_UP = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]


@pytest.mark.parametrize(
    ("factor", "words", "says"),
    [
        (1.0, (), "is taken as metres"),
        (1e3, (), "is taken as millimetres"),
        (1e2, (), "is taken as centimetres"),
        (1e3, ("--unit", "mm"), None),
        (1 / 0.3048, ("--unit", "foot"), None),
    ],
)
def test_units(run, tmp_path, factor, words, says):
    found = measured(run, foreign(tmp_path / "a.xyz", room(), factor=factor), *words)
    for side, size in SIZE.items():
        # No noise; nine digits.
        assert found[side]["value_m"] == pytest.approx(size, abs=1e-5)
    said = " ".join(found["notes"])
    assert (says in said) if says else "is taken as" not in said
    assert "z is taken for it (--up)" in said


@pytest.mark.parametrize(
    ("factor", "words", "says"),
    [
        (1e3, ("--unit", "m"), "m large, which no room and no thing on a table is; in millimetres it would be "),
        (0.5, ("--unit", "mm"), "in metres it would be "),
        (1.0, ("--unit", "m"), None),
    ],
)
def test_a_size_that_nothing_has_is_said(run, tmp_path, factor, words, says):
    source = foreign(tmp_path / "a.xyz", room(), factor=factor)
    ran = run("convert", source, tmp_path / "b.ply", *words)
    assert ran.code == 0 and ((says in ran.out) if says else "no thing on a table" not in ran.out)


@pytest.mark.parametrize("words", [(), ("--up", "y")])
def test_a_cloud_with_y_up_has_its_three_sides(run, tmp_path, words):
    found = measured(run, foreign(tmp_path / "a.xyz", room(), turn=Y_UP), *words)
    for side, size in SIZE.items():
        assert found[side]["value_m"] == pytest.approx(size, abs=1e-5)
    assert ("y is taken for it" in " ".join(found["notes"])) == (not words)


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_every_direction_becomes_z(run, tmp_path, up):
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    (tmp_path / "a.xyz").write_text("\n".join(" ".join(f"{k * x}" for x in axis) for k in (1, 2)))
    assert run("convert", tmp_path / "a.xyz", tmp_path / "b.ply", "--up", up, "--unit", "m").code == 0
    assert np.allclose(jaxscan.load_cloud(tmp_path / "b.ply").xyz, [[[0, 0, 1], [0, 0, 2]]], atol=1e-12)


def test_ours_is_in_metres_with_z_up_and_nothing_is_guessed(run, tmp_path):
    jaxscan.save_cloud(room(), tmp_path / "a.ply")
    assert measured(run, tmp_path / "a.ply")["notes"] == []


def test_convert_keeps_the_digest(run, tmp_path):
    jaxscan.save_cloud(make_cloud(), tmp_path / "a.ply", calibration_digest="sha256:0123")
    assert run("convert", tmp_path / "a.ply", tmp_path / "b.pcd").code == 0
    assert run("convert", tmp_path / "b.pcd", tmp_path / "c.ply").code == 0
    assert read_cloud(tmp_path / "c.ply").about.calibration == "sha256:0123"


@pytest.mark.parametrize("suffix", [".ply", ".laz", ".e57"])
def test_convert_puts_a_cloud_on_a_map(run, tmp_path, suffix):
    pytest.importorskip("pyproj", reason="the extra `export` is not installed")
    cloud, place = make_cloud(), (356000.25, 5400000.5, 312.125)
    jaxscan.save_cloud(cloud, tmp_path / "a.ply")
    words = ("--epsg", "25832", "--offset", *place)
    assert run("convert", tmp_path / "a.ply", tmp_path / f"b{suffix}", *words).code == 0
    stored = read_cloud(tmp_path / f"b{suffix}")
    assert stored.about.epsg == 25832
    # Steps of LAS.
    assert np.abs(stored.cloud.xyz[stored.cloud.valid] - (cloud.xyz[cloud.valid] + np.array(place))).max() < 0.52e-4


def test_a_cloud_on_a_map_is_measured(run, tmp_path):
    """Singles have half a metre there."""
    cloud = room()
    xyz = cloud.xyz[cloud.valid].astype(float) + [356000.25, 5400000.5, 312.125]
    np.savetxt(tmp_path / "a.xyz", xyz, fmt="%.9f")
    found = measured(run, tmp_path / "a.xyz")
    for side, size in SIZE.items():
        # Doubles of 5.4e6 are a nanometre apart.
        assert found[side]["value_m"] == pytest.approx(size, abs=1e-5)
    assert "is taken as metres" in " ".join(found["notes"])


@pytest.mark.parametrize("suffix", [".ply", ".e57"])
def test_a_cloud_of_ours_on_a_map_is_measured_with_its_calibration(tiny, run, tmp_path, suffix):
    target = tmp_path / f"map{suffix}"
    assert run("convert", tiny.cloud, target, "--offset", 356000.25, 5400000.5, 312.125).code == 0
    here, there = (measured(run, cloud, "-c", tiny.calibration) for cloud in (tiny.cloud, target))
    for side in ("length", "width"):
        # The random hypotheses meet other roundings of the same points.
        assert there[side]["value_m"] == pytest.approx(here[side]["value_m"], abs=1e-4)
        assert there[side]["sigma_m"] == pytest.approx(here[side]["sigma_m"], rel=0.02)


def test_convert_says_what_it_takes_for_granted(run, tmp_path):
    ran = run("convert", foreign(tmp_path / "a.xyz", room(), factor=1e3), tmp_path / "b.ply", "--json", "-")
    notes = json.loads(ran.out)["notes"]
    assert [("millimetres" in note, "what is up" in note) for note in notes] == [(True, False), (False, True)]
    found = jaxscan.load_cloud(tmp_path / "b.ply").xyz[0]
    # Nine digits of text.
    assert np.abs(found - room().xyz.reshape(-1, 3)).max() < 1e-6


def test_options_of_clouds_are_for_clouds(run, refused, tmp_path, tiny):
    for words in (("--epsg", "25832"), ("--unit", "mm"), ("--up", "y"), ("--offset", 1, 2, 3)):
        assert "is for clouds" in refused("convert", tiny.calibration, tmp_path / "a.yaml", *words)
    assert "--offset" in refused("convert", tiny.cloud, tmp_path / "a.ply", "--offset", "nan", 0, 0)
    assert "EPSG:4326" in refused("convert", tiny.cloud, tmp_path / "a.las", "--epsg", "4326")


def test_measure_says_that_a_cloud_has_no_sigmas(run, tmp_path):
    np.savetxt(tmp_path / "a.xyz", XYZ, fmt="%.4f")
    on_wall = XYZ[np.isclose(XYZ[:, 0], -1.5)][0]
    ran = run("measure", "plane", tmp_path / "a.xyz", "--at", *on_wall, "--radius-mm", 1200, "--unit", "m")
    assert "the cloud has no sigmas: 0.1 mm of noise a point is assumed" in " ".join((ran.out + ran.err).split())


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--columns", "x,y"), "expected x, y and z"),
        (("--columns", "x,y,z,colour"), 'found "colour"'),
        (("--columns", "x,y,z,r,g,b,i,nx"), "has 6 columns, and --columns lists 8"),
    ],
)
def test_columns_that_cannot_be_are_refused(refused, tmp_path, words, says):
    np.savetxt(tmp_path / "a.xyz", np.hstack([XYZ, RGB]), fmt="%.4f")
    assert says in refused("convert", tmp_path / "a.xyz", tmp_path / "b.ply", *words)


def test_a_person_overrules_what_is_found(run, tmp_path):
    # Half as bright as 8 bits are: 4 bits.
    np.savetxt(tmp_path / "a.xyz", np.hstack([RGB // 2, XYZ, LEVEL[:, None]]), fmt="%.4f")
    words = ("--columns", "r,g,b,z,y,x", "--colours", "1023", "--unit", "mm")
    ran = run("convert", tmp_path / "a.xyz", tmp_path / "b.ply", *words)
    assert ran.code == 0 and "by --columns" in ran.out and "colours 0 to 1023 by --colours" in ran.out
    assert "millimetres by --unit" in ran.out
    points = jaxscan.load_cloud(tmp_path / "b.ply").points()
    np.testing.assert_allclose(points.xyz, XYZ[:, ::-1] / 1000, atol=1e-9)
    assert np.array_equal(points.rgb, np.round(RGB // 2 * 255 / 1023))
    run("convert", tmp_path / "a.xyz", tmp_path / "c.ply", *words[:2], "--colours", "none")
    assert "rgb" in jaxscan.load_cloud(tmp_path / "c.ply").lacks


def test_a_map_in_feet_loses_its_code_with_its_feet(run, tmp_path):
    pytest.importorskip("laspy", reason="the extra `export` is not installed")
    next(one for one in STRANGERS if one.name.startswith("las feet:")).write(tmp_path / "a.las")
    ran = run("convert", tmp_path / "a.las", tmp_path / "b.laz")
    assert ran.code == 0 and "EPSG:2277 is of the coordinates before they became metres" in ran.out
    assert read_cloud(tmp_path / "b.laz").about.epsg is None
