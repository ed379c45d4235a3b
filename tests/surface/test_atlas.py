"""The picture on a mesh of any faces: each place shows the colour of that place, and walls are whole charts."""

import numpy as np
import pytest

from jaxscan.surface import Mesh, coloured_mesh, mesh_grid, simplify_mesh, texture_any_mesh
from jaxscan.surface.atlas import components, make_charts
from tests.surface.conftest import scan

from .test_texture import colour_of


@pytest.fixture(scope="module")
def few():
    """The room of 6000 faces, most of them large and some small."""
    cloud, eyes = scan(180, 76)
    return simplify_mesh(coloured_mesh(mesh_grid(cloud, eyes)), 6000)


def known(points, normals):
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
    return colour_of(points).astype(np.uint8), np.ones(len(points), np.bool_)


def shown(mesh, weights):
    """Colours of the picture, and true ones, at a place of every face."""
    rows, columns, _ = mesh.texture.shape
    uv = np.einsum("k,mkc->mc", weights, mesh.uv[mesh.faces])
    place = np.einsum("k,mkc->mc", weights, mesh.vertices[mesh.faces].astype(np.float64))
    return mesh.texture[(uv[:, 1] * rows).astype(int), (uv[:, 0] * columns).astype(int)], colour_of(place)


@pytest.mark.more
@pytest.mark.parametrize("weights", [(1 / 3, 1 / 3, 1 / 3), (0.9, 0.06, 0.04), (0.04, 0.9, 0.06), (0.48, 0.48, 0.04)])
def test_a_texel_has_the_colour_of_its_place(few, weights):
    mesh = texture_any_mesh(few, known, 300.0)
    found, true = shown(mesh, np.array(weights))
    # A texel is 4 to 13 mm wide, of which a colour changes by 40 levels a metre; both are rounded.
    off = np.abs(found - true).max(1)
    assert np.median(off) <= 1 and np.quantile(off, 0.99) < 2.5
    # Charts of neighbours that fold over each other may share a texel.
    assert off.max() < 40 * 0.2


def test_the_surface_is_as_it_was(few):
    mesh = texture_any_mesh(few, known, 100.0)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], few.vertices[few.faces])
    np.testing.assert_array_equal(mesh.rgb[mesh.faces], few.rgb[few.faces])
    assert mesh.uv.min() > 0 and mesh.uv.max() < 1


def test_walls_are_whole_and_faces_are_squeezed_little(few):
    chart, direction, directions = make_charts(few)
    corners = few.vertices[few.faces].astype(np.float64)
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(areas, axis=1)
    cosine = np.sum(areas * directions[direction[chart]], 1) / size
    assert cosine.min() > 0.35
    # Six sides of a room with furniture: the six largest charts have most of it.
    shares = np.sort(np.bincount(chart, size) / size.sum())[::-1]
    assert shares[:6].sum() > 0.75
    np.testing.assert_allclose(np.abs(directions).max(1), 1, atol=0.01)


def test_directions_are_those_of_the_walls(few):
    angle = np.radians(30)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    turned = few._replace(vertices=(few.vertices @ turn.T).astype(np.float32))
    _, _, directions = make_charts(turned)
    # Each wall's direction is one of the six.
    np.testing.assert_allclose((turn.T @ directions.T).__abs__().max(0), 1, atol=1e-3)


def test_every_texel_of_a_face_is_asked_for_once(few):
    """As many are asked for as the faces are large in the picture; and one for each vertex."""
    asked = []

    def count(points, normals):
        asked.append(points)
        return np.zeros((len(points), 3), np.uint8), np.ones(len(points), np.bool_)

    mesh = texture_any_mesh(few, count, 300.0)
    corners = mesh.uv[mesh.faces].astype(np.float64) * mesh.texture.shape[1::-1]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2
    assert sum(map(len, asked)) - len(mesh.vertices) == pytest.approx(area, rel=0.02)


def test_what_no_photograph_shows_has_the_colours_of_the_vertices(few):
    painted = few._replace(rgb=colour_of(few.vertices).astype(np.uint8))
    nothing = lambda points, _: (np.zeros((len(points), 3), np.uint8), np.zeros(len(points), np.bool_))
    found, true = shown(texture_any_mesh(painted, nothing, 300.0), np.full(3, 1 / 3))
    assert np.quantile(np.abs(found - true).max(1), 0.99) < 3


def test_a_picture_is_never_larger_than_graphics_cards_hold(few):
    one = Mesh(few.vertices[few.faces[0]] * 40, few.normals[:3], few.rgb[:3], np.array([[0, 1, 2]], np.int32))
    far = np.array([[10.0, -4000, -1], [10, 4000, -1], [10, 0, 1]], np.float32)
    mesh = texture_any_mesh(one._replace(vertices=far), known, 1e5)
    assert max(mesh.texture.shape) <= 16_384 and mesh.texture.shape[1] > 8000


def test_parts_are_connected():
    pairs = np.array([[5, 1], [1, 3], [0, 4], [3, 6]])
    np.testing.assert_array_equal(components(pairs, 8), [0, 1, 2, 1, 0, 1, 1, 3])
    np.testing.assert_array_equal(components(np.zeros((0, 2), int), 2), [0, 1])
