"""Clouds that were levelled, or put on a map: whatever is made of them is what it was, in its new place."""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxscan
from jaxscan import api
from jaxscan.errors import CloudError
from jaxscan.reconstruction import Stations, in_scanner_frame, join_clouds

from .measurement.rooms import CUPBOARD, DOOR, WINDOW, seen_room


CORNER = np.array([[0.8, -0.6, 0.0, 2.6], [0.6, 0.8, 0.0, 1.9], [0.0, 0.0, 1.0, 1.3], [0.0, 0.0, 0.0, 1.0]])
"""T_room_scanner: the origin is in a corner of the room, on its floor."""
MAP = CORNER + np.pad([[356_000.0], [5_400_000.0], [300.0]], ((0, 1), (3, 0)))


def moved(cloud, pose):
    """The cloud of one station, at another place; on a map in double precision."""
    host = jax.tree.map(np.asarray, cloud)
    wide = dataclasses.replace(host, xyz=host.xyz.astype(np.float64)) if pose is MAP else host
    return join_clouds([wide], [pose], [np.zeros((6, 6))])


@pytest.mark.more
@pytest.mark.parametrize("pose", [CORNER, MAP], ids=["corner", "map"])
def test_drawings(pose):
    """The same lengths, openings and sections to a tenth of the finest sigma, wherever the origin is."""
    room = seen_room(niches=(DOOR, WINDOW), boxes=(CUPBOARD,), grid=(240, 80))
    fields = {name: getattr(room, name) for name in ("xyz", "sigma_random", "valid", "laser", "angle", "rgb")}
    stations = Stations(np.zeros(len(room.valid), int), pose[None], np.zeros((1, 6, 6)))
    placed = SimpleNamespace(**fields | {"xyz": room.xyz @ pose[:3, :3].T + pose[:3, 3], "stations": stations})
    first, second = jaxscan.survey_room(room), jaxscan.survey_room(placed)
    for one, other in ((first.outline, second.outline),):
        for name in ("height", "floor_area", "volume"):
            assert getattr(other, name)().value == pytest.approx(getattr(one, name)().value, rel=1e-5)
        lengths = [sorted(each.value for each in outline.lengths()[0]) for outline in (one, other)]
        np.testing.assert_allclose(*lengths, atol=1e-4)
    kinds = [
        sorted((one.kind, round(one.width.value, 3)) for loop in survey.openings for side in loop for one in side)
        for survey in (first, second)
    ]
    assert kinds[0] == kinds[1] and len(kinds[0]) == 2
    # The frame of the plan leads back to the cloud.
    np.testing.assert_allclose(
        second.outline.frame.back(second.p)[room.valid.ravel()], placed.xyz[room.valid], atol=1e-6
    )


@pytest.fixture(scope="module")
def scanned(tiny):
    """Cloud, capture and scanner of the tiny room."""
    return (
        jaxscan.load_cloud(tiny.cloud),
        jaxscan.open_capture(tiny.sweep),
        jaxscan.load_scanner(tiny.calibration),
    )


@pytest.mark.more
@pytest.mark.parametrize("pose", [CORNER, MAP], ids=["corner", "map"])
def test_photographs(scanned, pose):
    cloud, capture, scanner = scanned
    placed = moved(cloud, pose)
    colours = [np.asarray(jaxscan.colour_cloud(one, capture, scanner).rgb, int) for one in (cloud, placed)]
    # Rounding moves a point by less than a thousandth of a pixel.
    assert np.mean(np.abs(colours[1] - colours[0]) > 1) < 0.01
    around = [jaxscan.draw_panorama(capture, scanner, cloud=one, width=400) for one in (cloud, placed)]
    assert np.mean(np.abs(around[1].rgb.astype(int) - around[0].rgb) > 1) < 0.01
    # At edges rounding decides which surface a pixel shows.
    assert np.mean(np.abs(around[1].distance_m - around[0].distance_m) > 2e-5) < 1e-3


@pytest.mark.more
@pytest.mark.parametrize("pose", [CORNER, MAP], ids=["corner", "map"])
def test_meshes(scanned, pose):
    cloud, capture, scanner = scanned
    placed = moved(cloud, pose)
    texture = api.Texture(capture)
    for make in (
        lambda one: jaxscan.mesh_cloud(one, scanner=scanner),
        lambda one: api.textured_mesh(one, scanner, texture),
        lambda one: api.draw_texture(jaxscan.mesh_cloud(one, scanner=scanner), one, scanner, texture),
    ):
        first, second = make(cloud), make(placed)
        there = first.vertices.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        if first.texture is not None and first.texture.shape != second.texture.shape:
            # Charts of another packing have their vertices in another order.
            there, second = (
                np.unique(there.round(4), axis=0),
                second._replace(vertices=np.unique(second.vertices.astype(np.float64).round(4), axis=0)),
            )
            assert len(there) == pytest.approx(len(second.vertices), rel=0.01)
            continue
        np.testing.assert_allclose(second.vertices, there, atol=2e-6)
        np.testing.assert_allclose(second.normals, first.normals @ pose[:3, :3].T, atol=1e-5)
        if first.texture is not None:
            assert np.mean(np.abs(second.texture.astype(int) - first.texture) > 2) < 0.02


def test_photographs_of_several_stations_are_refused(scanned):
    cloud, _, _ = scanned
    joined = join_clouds([cloud, cloud], [np.eye(4), CORNER], [np.zeros((6, 6))] * 2)
    with pytest.raises(CloudError, match="several stations; take the cloud of one"):
        in_scanner_frame(joined)
