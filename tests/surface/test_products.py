"""Meshes with fewer faces, and through the points of several stations."""

import dataclasses

import numpy as np
import pytest

from jaxscan.api import poisson_mesh, simplify_mesh
from jaxscan.errors import CloudError
from jaxscan.surface import coloured_mesh, mesh_grid
from tests.surface.conftest import SIGMA, scan, surface_distance


def test_fewer_faces_stay_on_the_surface(room):
    cloud, eyes = room
    mesh = coloured_mesh(mesh_grid(cloud, eyes))
    less = simplify_mesh(mesh, 20_000)
    assert 10_000 < len(less.faces) <= 20_000
    assert less.faces.max() == len(less.vertices) - 1 == len(less.rgb) - 1 == len(less.normals) - 1
    away = surface_distance(less.vertices.astype(np.float64))
    # Corners that collapsed lie off their planes by what the corners of the grid were cut.
    assert np.median(away) < SIGMA and np.quantile(away, 0.95) < 10e-3
    # On the walls, whose colours are those of their normals, a vertex has the colour of its wall.
    ceiling = np.abs(less.vertices[:, 2] - 1.4) < 1e-3
    np.testing.assert_allclose(np.median(less.rgb[ceiling], 0), [128, 128, 28], atol=3)


def test_few_faces_stay_as_they_are(room):
    cloud, eyes = room
    mesh = coloured_mesh(mesh_grid(cloud, eyes))
    assert simplify_mesh(mesh, 10**9) is mesh


def test_poisson_closes_a_hole():
    cloud, _ = scan(180, 76)
    valid = cloud.valid.copy()
    valid[10:12, 35:38] = False
    mesh = poisson_mesh(dataclasses.replace(cloud, valid=valid))
    places = cloud.xyz[~valid].astype(np.float64)
    gap = np.min(np.linalg.norm(mesh.vertices[None].astype(np.float64) - places[:, None], axis=-1), 1)
    # A vertex is nearer than a cell of the octree, which is as large as the points are apart.
    assert gap.max() < 0.1
    # A tenth of that: the surface is smooth, and rounds the corners of the furniture.
    assert np.median(surface_distance(mesh.vertices.astype(np.float64))) < 10e-3


def test_poisson_needs_points(room):
    cloud, _ = room
    valid = np.zeros_like(cloud.valid)
    valid[:5, :5] = True
    with pytest.raises(CloudError, match="found 25 points"):
        poisson_mesh(dataclasses.replace(cloud, valid=valid))
