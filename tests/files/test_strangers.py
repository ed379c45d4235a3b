"""Clouds of other programs: the right points, colours and sizes, or a reason; and nothing that was not there."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxscan.errors import JaxscanError
from jaxscan.files.clouds import Reading, in_metres, load_cloud, parse_columns, read_cloud, save_cloud

from .clouds import make_cloud
from .conftest import refused
from .strangers import COUNT, NORMAL, RGB, STRANGERS, XYZ


def read(stranger, path):
    """The cloud in metres, and what is said."""
    if stranger.suffix in (".e57", ".las"):
        pytest.importorskip("pye57" if stranger.suffix == ".e57" else "laspy", reason="the extra `export`")
    stranger.write(path)
    columns = dict(zip(stranger.options[::2], stranger.options[1::2], strict=True)).get("--columns")
    stored = read_cloud(path, Reading(None if columns is None else parse_columns(columns)))
    cloud, notes = in_metres(stored)
    return stored, cloud, " ".join(notes)


@pytest.mark.parametrize("stranger", STRANGERS, ids=lambda one: one.name)
def test_a_stranger_is_read_right_or_refused_with_its_reason(tmp_path, stranger):
    path = tmp_path / f"a{stranger.suffix}"
    if stranger.refused:
        refused(JaxscanError, lambda: read(stranger, path), stranger.says)
        return
    stored, cloud, said = read(stranger, path)
    assert stranger.says in said
    # Every file of another program has its line, which names the columns.
    assert said.startswith("x, y, z") or said.startswith("range, azimuth, elevation")
    points = cloud.points()
    assert len(points.xyz) == COUNT
    if np.isnan(stranger.offset).any():
        return
    # Four digits, singles, and steps of 0.01 mm of LAS; PTX is read from the top.
    distance, at = cKDTree(points.xyz).query(XYZ)
    assert distance.max() < 2e-5 and len(np.unique(at)) == COUNT
    if stranger.unit is not None:
        np.testing.assert_allclose(stored.about.metres[0], stranger.unit, rtol=1e-6)
    assert ("rgb" in cloud.lacks) == (not stranger.coloured)
    if stranger.coloured:
        assert np.array_equal(points.rgb[at], RGB)
    if stranger.normals:
        np.testing.assert_allclose(points.normals[at], NORMAL, rtol=0, atol=1e-4)
    if stranger.intensity is not None:
        np.testing.assert_allclose(points.intensity[at], stranger.intensity, rtol=1e-4, atol=1e-3)
    assert ("sigma_random" in cloud.lacks) == (not stranger.name.startswith("ply sigma"))
    assert "sigma_systematic" in cloud.lacks


@pytest.mark.parametrize("suffix", [".ply", ".npz", ".pcd", ".e57", ".las", ".laz", ".ptx", ".xyz"])
def test_what_a_cloud_lacks_is_not_written_by_any_format(tmp_path, suffix):
    """A PLY of x, y, z became black, without a normal, and perfect: sigma 0."""
    pytest.importorskip("laspy", reason="the extra `export` is not installed")
    np.savetxt(tmp_path / "a.xyz", XYZ, fmt="%.4f")
    cloud = load_cloud(tmp_path / "a.xyz")
    assert set(cloud.lacks) == {"rgb", "intensity", "normals", "sigma_random", "sigma_systematic", "grid"}
    save_cloud(cloud, tmp_path / f"b{suffix}")
    back = load_cloud(tmp_path / f"b{suffix}")
    # PTX is a grid of one column.
    assert set(back.lacks) == set(cloud.lacks) - ({"grid"} if suffix == ".ptx" else set())
    assert len(back.points().xyz) == COUNT


@pytest.mark.parametrize("suffix", [".ply", ".npz", ".pcd", ".e57", ".las"])
@pytest.mark.parametrize("name", ["sigma_systematic", "rgb", "normals", "intensity"])
def test_a_cloud_on_its_grid_may_lack_things(tmp_path, suffix, name):
    pytest.importorskip("laspy", reason="the extra `export` is not installed")
    whole = make_cloud()
    cloud = dataclasses.replace(whole, absent=(name,), **{name: np.zeros_like(getattr(whole, name))})
    save_cloud(cloud, tmp_path / f"a{suffix}")
    back = load_cloud(tmp_path / f"a{suffix}")
    assert back.lacks == (name,) and np.array_equal(back.valid, whole.valid)
    assert np.array_equal(back.sigma_random[back.valid], whole.sigma_random[whole.valid])
