"""Print of 6 mm letters on a wall, as 2.5 m away: read in the colours of points, and in the picture on a mesh.

A lens of 1500 px makes the letters 3.6 px high there; of all photographs together they are clearer than in any one.
"""

import numpy as np
import pytest

from jaxscan.photographs import Photograph, Photographs, colour_points, make_occluder
from jaxscan.simulation import make_scene, render_sweep, true_scanner
from jaxscan.simulation.scene.textures import Blend, Material
from jaxscan.surface import mesh_grid, texels_of_pixels, textured_mesh
from tests.photographs.rendered import World, cloud_of


pytestmark = pytest.mark.more


LETTERS = ("THE PRINT", "IS 6 MM HIGH")
WALL, LENS = 1.99, 1180.0
"""The wall [m], 2 m from the axis: a lens of 1180 px there shows as much as one of 1500 px at 2.5 m."""
HIGH, WIDE = 200, 800
"""Pixels of the page, of a quarter of a millimetre."""


@pytest.fixture(scope="module")
def page():
    """Share of ink [HIGH, WIDE]."""
    cv2 = pytest.importorskip("cv2")
    paper = np.full((HIGH, WIDE), 255, np.uint8)
    for row, line in enumerate(LETTERS):
        cv2.putText(paper, line, (40, 80 + 60 * row), cv2.FONT_HERSHEY_SIMPLEX, 24 / 21, 0, 3, cv2.LINE_AA)
    return 1 - paper.astype(np.float32) / 255


@pytest.fixture(scope="module")
def printed(world, page):
    """The corner with the page on its wall, from 17 places."""

    def pattern(u, v):
        # Metres from a corner of the wall, which has the page in its middle.
        right, up = u - 0.2, v - 0.075
        column, row = (np.clip((k * 4000).astype(int), 0, n - 1) for k, n in ((right, WIDE), (up, HIGH)))
        return Blend(0, 1, page[HIGH - 1 - row, column], 1.0)

    def extras(mesh):
        corner = np.array([1.5 + WALL, 2.0 + 0.3, 1.2 - 0.1])
        mesh.quad(corner, np.array([0, -0.6, 0]), np.array([0, 0, 0.2]), Material(((0.8,) * 3, (0.05,) * 3), pattern))

    lens = {"width": 280, "height": 160, "fx": LENS, "fy": LENS, "cx": 139.0, "cy": 80.0, "k1": 0.0}
    config = world.config.model_copy(update={"camera": world.config.camera.model_copy(update=lens)})
    scene, angles = make_scene(config, extras=extras), np.deg2rad(np.arange(-8.0, 9.0, 1.0))
    records = list(render_sweep(config, angles=angles, scene=scene))
    made = World(config, scene, true_scanner(config), None, angles, [record.off for record in records])
    return made._replace(cloud=cloud_of(made, records))


def is_read(found, ink):
    """As a reader would: the found print is nearest to its own letters, moved nowhere, and none of it is lost."""
    import cv2

    scale = WIDE // found.shape[1]
    blurred = cv2.GaussianBlur(ink, (0, 0), 1.0 / LENS * 2.0 * 4000 * 0.7)
    blurred = blurred.reshape(HIGH // scale, scale, WIDE // scale, scale).mean((1, 3))
    assert np.corrcoef(found.ravel(), blurred.ravel())[0, 1] > 0.95
    for line in range(len(LETTERS)):
        rows = slice((40 + 60 * line) // scale, (100 + 60 * line) // scale)
        columns = slice(40 // scale, 300 // scale)
        shifted = [np.roll(blurred, k // scale, 1)[rows, columns].ravel() for k in range(-40, 41, 4)]
        score = [np.corrcoef(found[rows, columns].ravel(), one)[0, 1] for one in shifted]
        assert int(np.argmax(score)) == 10


def test_letters_are_read_in_the_colours_of_points(printed, page):
    y, z = 0.1 - (np.arange(WIDE) + 0.5) / 4000, 0.025 - (np.arange(HIGH) + 0.5) / 4000
    points = np.stack([np.full((HIGH, WIDE), WALL), *np.meshgrid(y, z)], -1).reshape(-1, 3)
    shots = [Photograph(float(angle), image) for angle, image in zip(printed.angles, printed.images, strict=True)]
    rgb, seen = colour_points(Photographs(printed.scanner, shots), points, np.tile([-1.0, 0, 0], (len(points), 1)))
    assert seen.all()
    is_read(1 - rgb.mean(-1).reshape(page.shape) / rgb.max(), page)


def test_letters_are_read_on_a_mesh(printed, page):
    """The picture that a user gets by default: a texel for each pixel of the camera, profiles 35 mm apart."""
    grid = mesh_grid(printed.cloud, np.array(printed.eyes()))
    occluder = make_occluder(printed.cloud, printed.scanner)
    mesh = textured_mesh(
        grid,
        lambda points, normals: colour_points(printed.photographs, points, normals, occluder=occluder),
        texels_of_pixels(grid, LENS),
    )
    # Places on the faces of the wall, and what the picture shows there.
    rng = np.random.default_rng(4)
    corners = mesh.vertices[mesh.faces]
    faces = mesh.faces[(np.abs(corners[..., 0] - WALL) < 5e-3).all(1) & (np.abs(corners[..., 1]) < 0.2).all(1)]
    weights = rng.dirichlet(np.ones(3), (len(faces), 6000)).astype(np.float32)
    place = np.einsum("fnk,fkc->fnc", weights, mesh.vertices[faces]).reshape(-1, 3)
    uv = np.einsum("fnk,fkc->fnc", weights, mesh.uv[faces]).reshape(-1, 2)
    rows, columns, _ = mesh.texture.shape
    shown = mesh.texture[(uv[:, 1] * rows).astype(int), (uv[:, 0] * columns).astype(int)].mean(-1)
    # By half millimetres, each with so many places that none has none by chance.
    row, column = np.floor((0.025 - place[:, 2]) * 2000).astype(int), np.floor((0.1 - place[:, 1]) * 2000).astype(int)
    within = (row >= 0) & (row < HIGH // 2) & (column >= 0) & (column < WIDE // 2)
    total, count = np.zeros((2, HIGH // 2, WIDE // 2))
    np.add.at(total, (row[within], column[within]), shown[within])
    np.add.at(count, (row[within], column[within]), 1)
    assert count.min() > 0
    found = total / count
    is_read(1 - found / found.max(), page)
