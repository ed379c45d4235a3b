"""Colours of points and panoramas of a rendered corner of a room, against what the renderer knows."""

import json

import numpy as np
import pytest

from jaxscan.geometry import Scanner
from jaxscan.photographs import (
    Photograph,
    Photographs,
    colour_points,
    describe_cameras,
    make_occluder,
    make_panorama,
    panorama_frame,
)

from .rendered import BOX, BOX_Y, WALL_X, make_world, wall_albedo


@pytest.fixture(scope="module")
def world():
    return make_world()


def on_the_wall(spacing_m=0.01):
    """Places on the wall, between all that stands before it and the border of the photographs."""
    y, z = np.meshgrid(np.arange(-0.9, 1.2, spacing_m), np.arange(-0.5, 0.6, spacing_m))
    points = np.stack([np.full(y.size, WALL_X), y.ravel(), z.ravel()], -1)
    return points, np.tile([-1.0, 0.0, 0.0], (len(points), 1))


def seen_by_any(world, points):
    """Whether at least one place of the camera has nothing between it and each point."""
    return np.any([world.truth(points, eye)[1] for eye in world.eyes()], 0)


def psnr(found, true):
    return 10 * np.log10(255**2 / np.mean((found - true) ** 2))


def test_print_on_the_wall_is_sharper_than_between_stripes(world):
    """The profiles are 2 degrees apart, 6.6 cm on the wall; the lines of the print are 4 cm wide."""
    points, normals = on_the_wall()
    rgb, seen = colour_points(world.photographs, points, normals, occluder=make_occluder(world.cloud, world.scanner))
    true, _ = world.truth(points, np.zeros(3))
    # The colour of the nearest point of a stripe, which is what a cloud has without photographs.
    cloud = world.cloud.points()
    wall = np.abs(np.asarray(cloud.xyz)[:, 0] - WALL_X) < 1e-3
    apart = points[:, None, 1:] - np.asarray(cloud.xyz)[None, wall, 1:][:, ::4]
    stripes = np.asarray(cloud.rgb)[wall][::4][np.argmin(np.sum(apart**2, -1), 1)]
    assert seen.mean() > 0.75
    # Measured: 5.5 dB. The truth is not blurred by the lens, of which a pixel is 7 mm on this wall.
    assert psnr(rgb[seen].astype(float), true[seen]) > psnr(stripes[seen].astype(float), true[seen]) + 5
    # Ink and paper are told apart, away from the edges between them.
    inner = np.all(
        [
            wall_albedo(points[:, 1] + a, points[:, 2] + b) == wall_albedo(*points.T[1:])
            for a in (-0.012, 0.012)
            for b in (-0.012, 0.012)
        ],
        0,
    )
    grey, ink = rgb[:, 1].astype(float), wall_albedo(*points.T[1:]) > 0
    assert np.percentile(grey[seen & inner & ink], 99) < np.percentile(grey[seen & inner & ~ink], 1)


def test_what_stands_before_a_place_gives_it_no_colour(world):
    points, normals = on_the_wall(0.02)
    occluder = make_occluder(world.cloud, world.scanner)
    rgb, seen = colour_points(world.photographs, points, normals, occluder=occluder)
    free = seen_by_any(world, points)
    assert 0.02 < np.mean(~free) < 0.5
    # A band of a few pixels along an outline may go either way.
    assert np.mean(seen & ~free) < 0.01
    red = rgb[:, 0].astype(float) > 2 * rgb[:, 1] + 20
    # One place in two thousand, on the outline of the box, may take a share of it.
    assert red[seen & free].mean() < 5e-4
    # Without what stands there, the box is painted on the wall behind it.
    painted, _ = colour_points(world.photographs, points, normals)
    assert (painted[:, 0].astype(float) > 2 * painted[:, 1] + 20)[~free].mean() > 0.5


def test_the_front_of_the_box_is_red(world):
    y, z = np.meshgrid(np.linspace(BOX_Y[0] + 0.03, BOX_Y[1] - 0.03, 9), np.linspace(-0.4, 0.0, 9))
    points = np.stack([np.full(y.size, BOX[0]), y.ravel(), z.ravel()], -1)
    rgb, seen = colour_points(
        world.photographs,
        points,
        np.tile([-1.0, 0.0, 0.0], (len(points), 1)),
        occluder=make_occluder(world.cloud, world.scanner),
    )
    assert seen.all() and (rgb[:, 0] > 2 * rgb[:, 1].astype(float)).all()


def test_places_that_no_photograph_shows_keep_their_colour(world):
    points = np.array([[-3.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
    start = np.array([[1, 2, 3], [40, 50, 60]], np.uint8)
    rgb, seen = colour_points(world.photographs, points, np.zeros((2, 3)), start=start)
    np.testing.assert_array_equal(rgb, start)
    assert not seen.any()
    rgb, seen = colour_points(world.photographs, points[:0], points[:0])
    assert rgb.shape == (0, 3) and seen.shape == (0,)


def test_a_photograph_of_another_size_is_refused(world):
    odd = Photographs(world.scanner, [Photograph(0.0, np.zeros((3, 4, 3), np.uint8))])
    with pytest.raises(ValueError, match=r"must be uint8 \[240, 320, 3\], got uint8 with shape \(3, 4, 3\)"):
        colour_points(odd, np.ones((1, 3)), np.zeros((1, 3)))


def test_a_panorama_shows_places_where_its_frame_says(world):
    """The bar on the wall is straight in space: its rows are found in the picture, and lie on it to half a pixel."""
    frame = panorama_frame(world.scanner, "equirectangular", 1600)
    drawn = make_panorama(world.photographs, frame, world.cloud)
    y = np.linspace(-0.6, 0.2, 60)
    off = []
    for one in y:
        z = 0.12 * one + 0.45 + np.linspace(-0.08, 0.08, 81)
        q = frame.pixels(np.stack([np.full(81, WALL_X), np.full(81, one), z], -1))
        rows, column = np.rint(q[:, 1]).astype(int), round(float(q[40, 0]))
        dark = 200.0 - drawn.rgb[rows.min() : rows.max() + 1, column, 1].astype(float)
        dark -= dark.min()
        off.append(np.sum(dark * np.arange(rows.min(), rows.max() + 1)) / dark.sum() - q[40, 1])
    off = np.array(off)
    assert np.sqrt(np.mean(off**2)) < 0.5 and np.abs(np.mean(off)) < 0.25
    assert drawn.distance_m is not None
    middle = np.rint(frame.pixels(np.array([[WALL_X, 0.6, 0.3]]))[0]).astype(int)
    far = np.linalg.norm([WALL_X, 0.6, 0.3])
    assert drawn.distance_m[middle[1], middle[0]] == pytest.approx(far, abs=0.01)


def test_poses_project_places_by_the_conventions_of_their_file(world):
    """Camera axes x right, y up, z back; `transform_matrix` takes them to the scanner; OpenCV's lens parameters."""
    names = [f"images/{k:06d}.png" for k in range(len(world.angles))]
    told = json.loads(json.dumps(describe_cameras(world.scanner, list(world.angles), names)))
    place = np.array([WALL_X, 0.3, 0.2, 1.0])
    for k in (5, 20, 33):
        frame = told["frames"][k]
        assert frame["file_path"] == names[k]
        x, y, z, _ = np.linalg.inv(frame["transform_matrix"]) @ place
        a, b = x / -z, -y / -z
        bend = 1 + told["k1"] * (a * a + b * b) + told["k2"] * (a * a + b * b) ** 2
        q = np.array([told["fl_x"] * a * bend + told["cx"], told["fl_y"] * b * bend + told["cy"]])
        ours = _pixel(world.scanner, world.angles[k], place[:3])
        # Their (0, 0) is the corner of the first pixel, and ours is its centre.
        np.testing.assert_allclose(q - 0.5, ours, atol=0.02)


def _pixel(scanner: Scanner, angle: float, place: np.ndarray) -> np.ndarray:
    inside = np.linalg.inv(np.asarray(scanner.pose(np.asarray(angle)))) @ np.append(place, 1.0)
    return np.asarray(scanner.camera.project(inside[:3]))
