"""The picture on a mesh: each place of a face shows the colour of that place in the room."""

import dataclasses

import numpy as np
import pytest

from jaxscan.errors import CloudError
from jaxscan.surface import coloured_mesh, mesh_grid, texels_of_pixels, textured_mesh
from tests.surface.conftest import scan


def colour_of(points):
    """Colours that change evenly with the place."""
    return np.clip(128 + 40 * points, 0, 255)


def test_a_texel_has_the_colour_of_its_place(room):
    cloud, eyes = room
    grid = mesh_grid(cloud, eyes)
    asked = []

    def colour(points, normals):
        asked.append(len(points))
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
        return colour_of(points).astype(np.uint8), np.ones(len(points), np.bool_)

    mesh = textured_mesh(grid, colour, (2, 2))
    rows, columns, _ = mesh.texture.shape
    assert (rows, columns) == (2 * 151, 2 * 360) and sum(asked) > 0.9 * rows * columns
    # The nearest texel to the centroid of every face.
    uv, place = mesh.uv[mesh.faces].mean(1), mesh.vertices[mesh.faces].astype(np.float64).mean(1)
    found = mesh.texture[(uv[:, 1] * rows).astype(int), (uv[:, 0] * columns).astype(int)]
    # A texel is up to 0.7 of its side from the centroid, which is 22 mm far away, and more where the surface is steep.
    off = np.abs(found - colour_of(place)).max(1)
    assert np.median(off) < 2 and np.quantile(off, 0.99) < 40 * 0.1


def test_a_long_chart_is_folded(room):
    """The picture stays narrow enough for every browser, and each face shows its place."""
    cloud, eyes = room
    grid = mesh_grid(cloud, eyes)
    mesh = textured_mesh(
        grid, lambda points, _: (colour_of(points).astype(np.uint8), np.ones(len(points), np.bool_)), (50, 1)
    )
    rows, columns, _ = mesh.texture.shape
    assert columns <= 8192 and rows < 3 * (150 + 32)
    plain = coloured_mesh(grid)
    np.testing.assert_array_equal(plain.vertices[plain.faces], mesh.vertices[mesh.faces])
    corners = mesh.uv[mesh.faces]
    assert np.ptp(corners, axis=1).max(0) == pytest.approx([50 / columns, 1 / rows], rel=1e-3)
    uv, place = corners.mean(1), mesh.vertices[mesh.faces].astype(np.float64).mean(1)
    found = mesh.texture[(uv[:, 1] * rows).astype(int), (uv[:, 0] * columns).astype(int)]
    off = np.abs(found - colour_of(place)).max(1)
    assert np.median(off) < 2 and np.quantile(off, 0.99) < 40 * 0.1


def test_a_texel_is_about_a_pixel(room):
    cloud, eyes = room
    grid = mesh_grid(cloud, eyes)
    # 360 profiles a turn, and 151 lines over 76 degrees.
    across, along = texels_of_pixels(grid, 1000.0)
    assert across == pytest.approx(np.radians(1) * 1000, abs=2) and along == pytest.approx(8.8, abs=1)
    # As many as a picture holds.
    across, along = texels_of_pixels(grid, 1e5)
    assert 0.3 < 360 * across * 150 * along / 16_384**2 < 1


def test_the_faces_are_those_without_a_texture(room):
    cloud, eyes = room
    grid = mesh_grid(cloud, eyes)
    plain = coloured_mesh(grid)
    mesh = textured_mesh(grid, lambda points, _: (np.zeros((len(points), 3), np.uint8), np.ones(len(points), np.bool_)))
    np.testing.assert_array_equal(plain.vertices[plain.faces], mesh.vertices[mesh.faces])
    # The first profile is at both ends of the picture.
    seam = mesh.uv[:, 0] == 1
    assert len(mesh.vertices) == len(plain.vertices) + seam.sum() and seam.any()
    assert np.ptp(mesh.uv[mesh.faces][..., 0], axis=1).max() < 1.5 / 360


def test_what_no_photograph_shows_has_the_colours_of_the_cloud(room):
    cloud, eyes = room
    cloud = dataclasses.replace(cloud, rgb=colour_of(cloud.xyz).astype(np.uint8))
    nothing = lambda points, _: (np.zeros((len(points), 3), np.uint8), np.zeros(len(points), np.bool_))
    mesh = textured_mesh(mesh_grid(cloud, eyes), nothing, (1, 1))
    column, line = 100, 75
    corners = cloud.xyz[column : column + 2, line : line + 2].reshape(-1, 3).astype(np.float64)
    np.testing.assert_allclose(mesh.texture[line, column], colour_of(corners).mean(0), atol=4)


def test_a_texture_for_no_graphics_card_is_refused():
    cloud, eyes = scan(90, 40)
    with pytest.raises(CloudError, match=r"at most 16384 px .* fewer texels"):
        textured_mesh(mesh_grid(cloud, eyes), lambda points, _: (points, points), (200, 500))
