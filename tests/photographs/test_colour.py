"""Colours of points from photographs: hidden places, fine print between the stripes, exposures, memory."""

import dataclasses
import weakref

import jax
import numpy as np
import pytest

from jaxscan.errors import CloudError
from jaxscan.photographs import Photograph, Photographs, colour_points, make_occluder, surface_samples
from jaxscan.photographs.colour import Tally, add, conclude
from jaxscan.photographs.photograph import packed, read_image
from tests.photographs.rendered import WALL_X


@pytest.fixture(scope="module")
def occluder(world):
    return make_occluder(world.cloud, world.scanner)


def wall(y, z):
    """Places on the wall, and its normals."""
    places = np.stack([np.full((len(z), len(y)), WALL_X), *np.meshgrid(y, z)], -1).reshape(-1, 3)
    return places, np.tile([-1.0, 0.0, 0.0], (len(places), 1))


def psnr(found, true):
    return 10 * np.log10(255**2 / np.mean((found.astype(float) - true) ** 2))


@pytest.mark.more
def test_hidden_places_take_no_colour_from_what_stands_before_them(world, occluder):
    points, normals = wall(np.arange(-1.0, 1.0, 0.01), np.arange(-0.5, 0.3, 0.01))
    rgb, seen = colour_points(world.photographs, points, normals, occluder=occluder)
    visible = np.any([world.truth(points, eye)[1] for eye in world.eyes()], 0)
    assert np.sum(~visible) > 2000
    assert not np.any(seen & ~visible)
    assert np.mean(seen[visible]) > 0.95  # Beside the box nothing counts as seen within a step of 2 degrees.
    # The box is red. Its light reaches a pixel beyond its edge by the blur of the lens.
    red = rgb[:, 0].astype(int) - rgb[:, 1]
    assert np.sum(red[seen] > 15) < 0.002 * np.sum(seen)
    assert np.all(rgb[~seen] == 0)


@pytest.mark.more
def test_points_between_the_stripes_are_6_db_better(world, occluder):
    samples = list(surface_samples(world.cloud, world.scanner, 0.004))
    points, normals, striped = (np.concatenate(part)[::7] for part in zip(*samples, strict=True))
    true, visible = world.truth(points, np.zeros(3))
    rgb, seen = colour_points(world.photographs, points, normals, occluder=occluder)
    both = seen & visible
    assert np.mean(both[visible]) > 0.85
    assert psnr(rgb[both], true[both]) > psnr(striped[both], true[both]) + 6


def test_colours_known_before_are_kept_where_no_photograph_shows_a_point(world, occluder):
    points, normals = wall(np.array([-0.1, 0.0]), np.array([-0.2]))
    start = np.array([[10, 200, 30], [0, 0, 0]], np.uint8)
    rgb, seen = colour_points(world.photographs, points, normals, occluder=occluder, start=start)
    assert not seen.any()
    np.testing.assert_array_equal(rgb, start)


def test_a_surface_seen_from_behind_has_no_colour(world, occluder):
    points, normals = wall(np.array([0.6]), np.array([0.2]))
    assert colour_points(world.photographs, points, normals, occluder=occluder)[1].all()
    assert not colour_points(world.photographs, points, -normals, occluder=occluder)[1].any()


def test_saturated_pixels_are_left_out(world, occluder):
    points, normals = wall(np.arange(0.3, 0.6, 0.02), np.array([0.1, 0.2]))
    expected, seen = colour_points(world.photographs, points, normals, occluder=occluder)
    burnt = [np.full_like(image, 255) if k % 2 else image for k, image in enumerate(world.images)]
    rgb, also = colour_points(world._replace(images=burnt).photographs, points, normals, occluder=occluder)
    assert seen.all() and also.all()
    assert np.max(np.abs(rgb.astype(int) - expected)) <= 2  # Half as many photographs have more noise.


@pytest.mark.more
def test_exposures_are_equalised(world, occluder):
    points, normals = wall(np.arange(0.3, 1.2, 0.02), np.arange(-0.5, 0.3, 0.02))
    expected, seen = colour_points(world.photographs, points, normals, occluder=occluder)
    change = 1 + 0.2 * np.random.default_rng(1).uniform(-1, 1, (len(world.images), 3))
    uneven = [
        np.clip(np.rint(image * factor), 0, 255).astype(np.uint8)
        for image, factor in zip(world.images, change, strict=True)
    ]
    rgb, _ = colour_points(world._replace(images=uneven).photographs, points, normals, occluder=occluder)
    apart = np.abs(rgb.astype(int) - expected)[seen]
    assert np.percentile(apart, 99) <= 2
    assert np.mean(apart) < 0.6  # Both are rounded.


def test_colours_that_disagree_are_kept_apart_and_the_heaviest_wins():
    tally = Tally(np.zeros((3, 3), np.float32), np.zeros(3, np.float32))
    grey = np.ones(3, np.float32)

    def more(level, weight):
        nonlocal tally
        tally = add(tally, level * grey, np.asarray(weight, np.float32), 20.0)
        return sorted((round(float(w), 3), round(float(t[0] / w))) for t, w in zip(*tally, strict=True) if w > 0)

    assert more(100, 0.0) == []
    assert more(100, 0.5) == [(0.5, 100)]
    # A difference of the tolerance is the same colour, and the mean of both counts from then on.
    assert more(120, 0.5) == [(1.0, 110)]
    assert more(131, 0.25) == [(0.25, 131), (1.0, 110)]
    assert more(10, 0.5) == [(0.25, 131), (0.5, 10), (1.0, 110)]
    # No room is left: a lighter one is forgotten, a heavier one takes the place of the lightest.
    assert more(200, 0.25) == [(0.25, 131), (0.5, 10), (1.0, 110)]
    assert more(200, 0.3) == [(0.3, 200), (0.5, 10), (1.0, 110)]
    assert conclude(Tally(*(np.asarray(field)[..., None] for field in tally)), 20.0).tolist() == [[110], [110], [110]]


@pytest.mark.parametrize("seed", range(5))
def test_between_pixels_a_colour_is_the_cubic_of_its_neighbours(seed):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (9, 11, 3), np.uint8)
    u, v = q = rng.uniform([-3, -3], [13, 11]).astype(np.float32)
    # Keys' kernel with a = -1/2, of all pixels of an image whose border goes on.
    wide = np.pad(image, ((9, 9), (9, 9), (0, 0)), "edge").astype(np.float64)

    def weights(place, size):
        t = np.abs(np.arange(-9, size + 9) - float(place))
        return np.where(t < 1, 1.5 * t**3 - 2.5 * t**2 + 1, np.where(t < 2, -(t**3) / 2 + 2.5 * t**2 - 4 * t + 2, 0))

    across, down = weights(u, 11), weights(v, 9)
    near = wide[np.abs(np.arange(-9, 18) - np.floor(v) - 0.5) < 2][:, np.abs(np.arange(-9, 20) - np.floor(u) - 0.5) < 2]
    expected = np.clip(np.einsum("r,c,rck->k", down, across, wide), near.min((0, 1)), near.max((0, 1)))
    with jax.enable_x64(False):
        colour, brightest = read_image(packed(image), q)
    # Some roundings of float32 at 255.
    np.testing.assert_allclose(np.asarray(colour), expected, atol=1e-3)
    assert float(brightest) == near.max()


def test_photographs_are_not_kept(world, occluder):
    """However many there are, two or three exist at a time: in use, being prepared, and the one that is read."""
    given, most = [], []

    def shots():
        for angle, image in zip(world.angles, world.images, strict=True):
            copy = image.copy()
            given.append(weakref.ref(copy))
            most.append(sum(one() is not None for one in given))
            yield Photograph(float(angle), copy)
            del copy

    points, normals = wall(np.array([0.5]), np.array([0.1]))
    colour_points(Photographs(world.scanner, shots()), points, normals, occluder=occluder)
    assert len(most) == len(world.images)
    assert max(most) <= 4


@pytest.mark.more
def test_the_setting_of_the_caller_does_not_matter(world, occluder):
    points, normals = wall(np.arange(0.3, 1.2, 0.05), np.arange(-0.5, 0.3, 0.05))
    found = colour_points(world.photographs, points, normals, occluder=occluder)
    with jax.enable_x64(False):
        again = colour_points(world.photographs, points, normals, occluder=occluder)
    np.testing.assert_array_equal(found[0], again[0])


def test_no_points(world):
    rgb, seen = colour_points(world.photographs, np.zeros((0, 3)), np.zeros((0, 3)))
    assert rgb.shape == (0, 3) and seen.shape == (0,)


def test_another_image_size_is_refused(world):
    shots = [Photograph(0.0, np.zeros((100, 100, 3), np.uint8))]
    with pytest.raises(ValueError, match=r"must be uint8 \[240, 320, 3\]"):
        colour_points(Photographs(world.scanner, shots), np.ones((1, 3)), np.zeros((1, 3)))


def test_a_cloud_without_grid_is_refused(world):
    flat = {name: getattr(world.cloud, name).reshape(1, -1, 3) for name in ("xyz", "rgb", "normals")}
    flat |= {name: getattr(world.cloud, name).reshape(1, -1) for name in ("intensity", "sigma_random", "valid")}
    flat |= {name: getattr(world.cloud, name)[:1] for name in ("record", "laser", "angle")}
    flat["sigma_systematic"] = flat["sigma_random"]
    with pytest.raises(CloudError, match="has no grid of profiles and lines"):
        make_occluder(dataclasses.replace(world.cloud, **flat), world.scanner)
