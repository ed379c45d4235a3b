"""Recordings for Rerun, read back by its own reader."""

import json
import os
import re

import numpy as np
import pytest

from jaxscan.files.clouds import load_cloud, save_cloud, shifted
from jaxscan.files.clouds.rerun import radius_of
from jaxscan.reconstruction import join_clouds

from ..cli.conftest import run as run
from ..files.clouds import make_cloud
from ..files.test_joined_clouds import COVARIANCE, SECOND


pytestmark = pytest.mark.rig


REQUIRED = "JAXSCAN_REQUIRE_PROGRAMS"
Z_UP = [[3, 5, 1]]
"""Right, forward, up, by Rerun's numbers."""


@pytest.fixture
def reader():
    """Columns of a recording by their places in it and their names."""
    try:
        chunks = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: make programs")
    except pytest.skip.Exception as skipped:
        if os.environ.get(REQUIRED):
            pytest.fail(f"{REQUIRED} is set, but: {skipped}")
        raise

    def read(path):
        found = {}
        for chunk in chunks.RrdReader(str(path)).stream():
            assert chunk.is_static and chunk.num_rows == 1
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if not name.startswith("rerun."):
                    found.setdefault(chunk.entity_path, {})[name] = batch.column(name)[0].as_py()
        return found

    return read


def rgb_of(colours):
    """Red, green and blue [n, 3] of Rerun's numbers."""
    packed = np.array(colours, np.uint32)
    assert (packed & 0xFF == 255).all()
    return np.stack([packed >> 24, packed >> 16 & 0xFF, packed >> 8 & 0xFF], -1)


def test_points_colours_and_sigmas_are_those_of_the_cloud(run, reader, tmp_path):
    path = tmp_path / "a room.ply"
    save_cloud(make_cloud(), path)
    ran = run("view", path, "--rerun", tmp_path / "room.rrd", "--json", tmp_path / "said.json")
    points = load_cloud(path).points()
    assert ran.code == 0 and ran.out.splitlines()[-1] == f"written: {tmp_path / 'room.rrd'} ({len(points.xyz)} points)"
    found = reader(tmp_path / "room.rrd")
    assert found["/"]["ViewCoordinates:xyz"] == Z_UP and found["/"]["origin_m"] == [0.0, 0.0, 0.0]
    # One name, whose slashes and spaces are escaped.
    place = "/" + re.sub(r"([^\w.-])", r"\\\1", str(path))
    cloud = found[place]
    np.testing.assert_array_equal(cloud["Points3D:positions"], points.xyz)
    np.testing.assert_array_equal(rgb_of(cloud["Points3D:colors"]), points.rgb)
    np.testing.assert_array_equal(cloud["sigma_random_m"], points.sigma_random)
    np.testing.assert_array_equal(cloud["sigma_systematic_m"], points.sigma_systematic)
    # Points of this cloud are decimetres apart, which is more than a mark should be.
    (radius,) = cloud["Points3D:radii"]
    assert 0 < radius <= 0.05
    station = found[f"{place}/stations"]
    assert station["Points3D:labels"] == ["station 1"] and station["Points3D:positions"] == [[0.0, 0.0, 0.0]]
    said = json.loads((tmp_path / "said.json").read_text())
    assert said["recording"] == str(tmp_path / "room.rrd") and said["points"] == len(points.xyz)


def test_stations_of_several_clouds_on_a_map_have_names(run, reader, tmp_path):
    corner = np.array([356_000.0, 5_400_000.0, 300.0])
    joined = join_clouds([make_cloud(), make_cloud(seed=1)], [np.eye(4), SECOND], [COVARIANCE] * 2)
    save_cloud(shifted(joined, tuple(corner)), tmp_path / "a.ply")
    save_cloud(shifted(make_cloud(), tuple(corner)), tmp_path / "b.ply")
    ran = run("view", tmp_path / "a.ply", tmp_path / "b.ply", "--rerun", tmp_path / "room.rrd")
    assert ran.code == 0 and "note: 0 of the recording is " in ran.out
    found = reader(tmp_path / "room.rrd")
    origin = np.array(found["/"]["origin_m"])
    assert np.abs(origin - corner).max() < 20
    for name in ("a.ply", "b.ply"):
        (place,) = (place for place in found if place.endswith(name))
        truth = load_cloud(tmp_path / name)
        np.testing.assert_allclose(
            np.array(found[place]["Points3D:positions"]) + origin, truth.points().xyz, rtol=0, atol=1e-5
        )
        stations = found[f"{place}/stations"]
        places = np.asarray(truth.stations.pose)[:, :3, 3]
        np.testing.assert_allclose(np.array(stations["Points3D:positions"]) + origin, places, rtol=0, atol=1e-5)
        labels = [f"{tmp_path / name}: station {1 + number}" for number in range(len(places))]
        assert stations["Points3D:labels"] == labels


def test_marks_on_a_wall():
    """A wall of 2 by 2 m whose points are 10 mm apart: marks just close it."""
    side = np.arange(0, 2, 0.01, np.float32)
    wall = np.stack([*map(np.ravel, np.meshgrid(side, side)), np.zeros(len(side) ** 2)], -1).astype(np.float32)
    assert radius_of(wall) == pytest.approx(0.005, rel=0.1)


def test_what_is_switched_off_is_said(run, reader, tmp_path, monkeypatch):
    monkeypatch.setenv("RERUN", "off")
    save_cloud(make_cloud(), tmp_path / "room.ply")
    ran = run("view", tmp_path / "room.ply", "--rerun", tmp_path / "room.rrd")
    assert ran.code == 1 and "Rerun records nothing" in ran.err and ran.err.count("\n") == 1
    assert not (tmp_path / "room.rrd").exists()
