"""Faces lie on the true surface, none across a jump, and the mesh is closed where the grid is."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from jaxscan.api import load_simulation, mesh_cloud
from jaxscan.errors import CloudError
from jaxscan.simulation.scene import make_scene
from jaxscan.surface import MeshSettings, coloured_mesh, mesh_grid
from tests.surface.conftest import SIGMA, parts, scan, stacked, surface_distance


ROOT = Path(__file__).resolve().parents[2]
STEP_M = np.radians(1.0) * 3.2
"""Distance between the rays of neighbours at the largest range of the room."""


def edges(faces):
    """Every edge of faces, its smaller corner first, and how many faces have it."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
    return np.unique(pairs, axis=0, return_counts=True)


def test_faces_lie_on_the_true_surface(room):
    cloud, eyes = room
    mesh = coloured_mesh(mesh_grid(cloud, eyes))
    away = surface_distance(mesh.vertices[mesh.faces].astype(np.float64).mean(1))
    # A face across a crease cuts the corner: its centroid is at most a third of the height of the corner from it.
    assert away.max() < 4 * SIGMA + STEP_M / 3
    body, side = (part[mesh.faces] for part in parts(mesh.vertices.astype(np.float64)))
    flat = (np.ptp(body, axis=1) == 0) & (np.ptp(side, axis=1) == 0)
    assert np.mean(flat) > 0.9
    # The mean of three points has less noise than one; of 1e5 Gaussian numbers the largest are 4.4 sigmas.
    assert away[flat].max() < 4.4 * SIGMA


def test_nearly_every_cell_has_its_faces(room):
    cloud, eyes = room
    profiles, lines = cloud.valid.shape
    # Outlines of the furniture are 2 % of the cells.
    assert len(mesh_grid(cloud, eyes).faces()) > 0.96 * 2 * profiles * (lines - 1)


def test_no_face_is_across_a_jump(room):
    """No face joins two bodies that do not touch: chest, table and post touch the floor alone, the shelf a wall too."""
    cloud, eyes = room
    mesh = coloured_mesh(mesh_grid(cloud, eyes))
    body, side = parts(mesh.vertices.astype(np.float64))
    low_x, low_z = 0, 2
    touching = {(0, k, low_z) for k in (1, 2, 3, 4)} | {(0, 2, low_x)}
    for k in range(3):
        one, other = mesh.faces[:, k], mesh.faces[:, k - 1]
        first, second = np.where(body[one] <= body[other], (one, other), (other, one))
        across = body[first] != body[second]
        found = set(zip(body[first[across]], body[second[across]], side[first[across]], strict=True))
        assert {(int(a), int(b), int(c)) for a, b, c in found} <= touching


@pytest.mark.parametrize("jump_sigmas", [0.0, 12.0])
def test_a_jump_on_a_wall_is_cut_by_its_sigmas(jump_sigmas):
    """A step in a plane, seen head-on and so finely that only noise can excuse it."""
    y, z = np.meshgrid(1e-4 * np.arange(60), 1e-4 * np.arange(50), indexing="ij")
    x = 2.0 + jump_sigmas * SIGMA * (np.arange(60) >= 30)[:, None] + 0 * z
    cloud, _ = scan(60, 50, turn=0.1)
    normals = np.zeros_like(cloud.normals) - np.array([1, 0, 0], np.float32)
    cloud = dataclasses.replace(cloud, xyz=np.stack([x, y, z], -1).astype(np.float32), normals=normals)
    mesh = mesh_grid(cloud)
    faces = np.count_nonzero(mesh.codes[29])
    assert faces == (0 if jump_sigmas else 49)
    assert np.count_nonzero(mesh.codes) == 59 * 49 - (49 if jump_sigmas else 0)


def test_the_mesh_is_closed_where_the_grid_is(room):
    cloud, eyes = room
    mesh = coloured_mesh(mesh_grid(cloud, eyes))
    profiles, lines = cloud.valid.shape
    grid = mesh_grid(cloud, eyes)
    assert grid.lattice.closes.sum() == 1 and len(grid.lattice.profile) == profiles + 1
    _, counts = edges(mesh.faces)
    assert counts.max() == 2
    # Joined across the end of the turn as elsewhere.
    across = np.count_nonzero(grid.codes, axis=1)
    assert across[-1] > 0.9 * np.median(across)
    # Both poles stay open: the first and the last line have borders only.
    assert len(mesh.vertices) <= profiles * lines


def test_an_empty_room_is_closed_but_for_its_poles():
    """Without noise and without furniture's outlines: one surface, whose borders are the two poles."""
    angle, down = 2 * np.pi * np.arange(90) / 90, np.linspace(1, -1, 40)
    a, e = np.meshgrid(angle, down, indexing="ij")
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).astype(np.float32)
    cloud, _ = scan(90, 40)
    cloud = dataclasses.replace(cloud, xyz=2 * rays, normals=-rays)
    mesh = coloured_mesh(mesh_grid(cloud))
    found, counts = edges(mesh.faces)
    assert len(mesh.vertices) == 90 * 40 and len(mesh.faces) == 2 * 90 * 39
    assert np.count_nonzero(counts == 1) == 2 * 90 and counts.max() == 2
    # Euler's number of a ring.
    assert len(mesh.vertices) - len(found) + len(mesh.faces) == 0


def test_part_of_a_turn_stays_open():
    cloud, eyes = scan(90, 60, turn=np.pi / 2)
    assert not mesh_grid(cloud, eyes).lattice.closes.any()


def test_a_turn_and_a_bit_is_closed_once(room):
    cloud, eyes = room
    more = stacked(cloud, dataclasses.replace(cloud, angle=cloud.angle + 2 * np.pi))
    more = dataclasses.replace(
        more,
        **{
            name: getattr(more, name)[:370]
            for name in vars(more)
            if name != "stations" and getattr(more, name) is not None
        },
    )
    mesh = mesh_grid(more, np.concatenate([eyes, eyes])[:370])
    np.testing.assert_array_equal(mesh.lattice.profile, [*range(360), 0])


def test_records_left_out_are_a_gap(room):
    cloud, eyes = room
    keep = np.delete(np.arange(360), np.arange(100, 110))
    fields = {name: value[keep] for name, value in vars(cloud).items() if value is not None}
    lattice = mesh_grid(dataclasses.replace(cloud, **fields), eyes[keep]).lattice
    assert np.flatnonzero(~lattice.joined).tolist() == [99]


def test_each_laser_is_a_sheet(room):
    cloud, eyes = room
    other, others = scan(360, 152, laser=1, first=0.002)
    mesh = mesh_grid(stacked(cloud, other), np.concatenate([eyes, others]))
    assert mesh.lattice.closes.sum() == 2
    corners = mesh.lattice.profile[mesh.faces() // 152] >= 360
    assert (corners.all(1) | ~corners.any(1)).all()


def test_faces_look_at_the_scanner(room):
    cloud, eyes = room
    mesh = coloured_mesh(mesh_grid(cloud, eyes))
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    normal = np.cross(b - a, c - a)
    # The camera is at most 0.2 m from the origin, and no surface is seen from beyond 80 degrees.
    way = -b / np.linalg.norm(b, axis=1, keepdims=True)
    cosine = np.sum(normal * way, 1) / np.linalg.norm(normal, axis=1)
    assert cosine.min() > np.cos(np.radians(80)) - 0.2 / 1.2
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_a_turn_in_the_other_sense_looks_at_the_scanner_too(room):
    cloud, eyes = room
    back = dataclasses.replace(cloud, angle=-cloud.angle)
    one, other = coloured_mesh(mesh_grid(cloud, eyes)), coloured_mesh(mesh_grid(back, eyes))
    assert abs(len(one.faces) - len(other.faces)) < 0.001 * len(one.faces)
    for mesh in (one, other):
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
        assert (np.sum(np.cross(b - a, c - a) * b, 1) < 0).mean() > 0.999


def test_single_missing_cells_are_bridged_where_both_sides_agree(room):
    cloud, eyes = room
    rng = np.random.default_rng(3)
    missing = rng.random(cloud.valid.shape) < 0.01
    holes = dataclasses.replace(cloud, valid=~missing, xyz=np.where(missing[..., None], 0, cloud.xyz))
    plain, bridged = (mesh_grid(holes, eyes, MeshSettings(bridge=one)) for one in (False, True))
    filled = np.asarray(bridged.cloud.valid) & missing
    assert filled.sum() > 0.9 * missing.sum()
    assert len(bridged.faces()) > len(plain.faces()) + 4 * 0.9 * missing.sum()
    # Half-way between two points on one surface, or on the chord of a corner two steps wide.
    assert np.quantile(surface_distance(bridged.cloud.xyz[filled].astype(np.float64)), 0.9) < 4 * SIGMA
    assert surface_distance(bridged.cloud.xyz[filled].astype(np.float64)).max() < STEP_M
    np.testing.assert_array_equal(bridged.cloud.xyz[~missing], cloud.xyz[~missing])


def test_the_camera_at_the_origin_changes_little(room):
    cloud, eyes = room
    with_places, without = len(mesh_grid(cloud, eyes).faces()), len(mesh_grid(cloud).faces())
    assert abs(with_places - without) < 0.002 * with_places


def test_a_cloud_far_away_keeps_its_shape(room):
    """In a national grid; singles would be half a metre apart."""
    cloud, eyes = room
    far = np.array([5e6, 3e6, 100.0])
    moved = dataclasses.replace(cloud, xyz=cloud.xyz.astype(np.float64) + far)
    mesh, near = coloured_mesh(mesh_grid(moved, eyes + far)), coloured_mesh(mesh_grid(cloud, eyes))
    assert mesh.vertices.dtype == np.float64
    assert abs(len(mesh.faces) - len(near.faces)) < 10


@pytest.mark.parametrize("points", [0, 1])
def test_without_points_there_is_no_face(room, points):
    cloud, eyes = room
    valid = np.zeros_like(cloud.valid)
    valid.flat[:points] = True
    with pytest.raises(CloudError, match="no face"):
        mesh_grid(dataclasses.replace(cloud, valid=valid), eyes)


def test_a_cloud_without_a_grid_is_refused(room):
    cloud, _ = room
    fields = {name: value[:1] for name, value in vars(cloud).items() if value is not None}
    with pytest.raises(CloudError, match=r"no grid .*found 1 x 152.*--poisson"):
        mesh_cloud(dataclasses.replace(cloud, **fields))


def test_faces_lie_on_the_surfaces_of_the_simulated_room():
    """Rays to the simulated room: its sofa, chairs and shelf have outlines of every kind."""
    scene = make_scene(load_simulation(ROOT / "configs" / "paper.toml"))

    def cast(origins, rays):
        shape = rays.shape[:-1]
        starts = np.broadcast_to(origins, rays.shape).reshape(-1, 3)
        return scene.cast(starts, rays.reshape(-1, 3))[0].reshape(shape)

    cloud, eyes = scan(360, 152, cast=cast)
    mesh = coloured_mesh(mesh_grid(cloud, eyes))
    centroids = mesh.vertices[mesh.faces].astype(np.float64).mean(1)
    ways = centroids / np.linalg.norm(centroids, axis=1, keepdims=True)
    # Along the normal from some millimetres before the face: a hit that far behind is its surface.
    normals = mesh.normals[mesh.faces].astype(np.float64).mean(1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lift = 0.02
    away = np.abs(cast(centroids + lift * normals, -normals) - lift)
    assert np.sum(normals * ways, 1).max() < 0.1
    assert np.median(away) < SIGMA
    # Faces across creases, and round the legs of chairs, are chords of what is thinner than two steps.
    assert np.mean(away < 4 * SIGMA) > 0.9
    assert np.mean(away < STEP_M / 2) > 0.998
