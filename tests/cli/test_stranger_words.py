"""What the command line says of other programs' clouds, and the options that overrule what is found."""

import numpy as np
import pytest

from jaxscan.files.clouds import load_cloud, read_cloud

from ..files.strangers import LEVEL, RGB, STRANGERS, XYZ


def test_measure_says_that_a_cloud_has_no_sigmas(run, refused, tmp_path):
    np.savetxt(tmp_path / "a.xyz", XYZ, fmt="%.4f")
    on_wall = XYZ[np.isclose(XYZ[:, 0], -1.5)][0]
    ran = run("measure", "plane", tmp_path / "a.xyz", "--at", *on_wall, "--radius-mm", 1200, "--unit", "m")
    assert "the cloud has no sigmas: 0.1 mm of noise a point is assumed" in " ".join((ran.out + ran.err).split())
    # Of single points nothing else tells how good they are.
    words = ("--a", *XYZ[0], "--b", *XYZ[5], "--unit", "m")
    assert "The cloud has no sigmas" in refused("measure", "points", tmp_path / "a.xyz", *words)


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
    points = load_cloud(tmp_path / "b.ply").points()
    np.testing.assert_allclose(points.xyz, XYZ[:, ::-1] / 1000, atol=1e-9)
    assert np.array_equal(points.rgb, np.round(RGB // 2 * 255 / 1023))
    run("convert", tmp_path / "a.xyz", tmp_path / "c.ply", *words[:2], "--colours", "none")
    assert "rgb" in load_cloud(tmp_path / "c.ply").lacks


def test_a_map_in_feet_loses_its_code_with_its_feet(run, tmp_path):
    pytest.importorskip("laspy", reason="the extra `export` is not installed")
    next(one for one in STRANGERS if one.name == "las feet").write(tmp_path / "a.las")
    ran = run("convert", tmp_path / "a.las", tmp_path / "b.laz")
    assert ran.code == 0 and "EPSG:2277 is of the coordinates before they became metres" in ran.out
    assert read_cloud(tmp_path / "b.laz").about.epsg is None
