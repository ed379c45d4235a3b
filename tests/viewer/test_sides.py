"""From which side points were seen, and which of them a place sees from behind."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxscan.viewer.picking import pick
from jaxscan.viewer.shown import ShownCloud, middle_of
from jaxscan.viewer.sides import gridded_normals, hides_well, seen_from, sides_of


SEED = 3
ROOM_M = np.array([2.6, 2.2, 1.3])


def box():
    """Points on the sides of a room about the origin [m], and their normals into the room."""
    rng = np.random.default_rng(SEED)
    at = rng.uniform(-1, 1, (3000, 3))
    axis, end = rng.integers(0, 3, 3000), rng.choice([-1.0, 1.0], 3000)
    each = np.arange(3000)
    at[each, axis] = end
    inwards = np.zeros((3000, 3))
    inwards[each, axis] = -end
    return at * ROOM_M, inwards


def sides_seen(normals, towards, *, certain):
    seen = lambda some: (normals[some], None if towards is None else towards[some])
    return sides_of(seen, len(normals), certain=certain)


def test_normals_towards_the_scanner_are_sides():
    at, inwards = box()
    inwards[:300] = 0
    sides = sides_seen(inwards, -at, certain=False)
    assert sides.dtype == np.int8 and np.array_equal(sides, 127 * inwards)


def test_normals_that_nobody_turned_are_turned_where_the_scanner_stood_for_certain():
    at, inwards = box()
    mixed = inwards * np.random.default_rng(SEED).choice([-1.0, 1.0], (3000, 1))
    assert np.array_equal(sides_seen(mixed, -at, certain=True), 127 * inwards)
    # An origin amid the points of a thing, whose normals point outwards, is no scanner.
    assert sides_seen(-inwards, -at, certain=False) is None
    assert sides_seen(inwards, None, certain=False) is None
    assert sides_seen(np.zeros_like(inwards), -at, certain=True) is None


def test_backs_are_hidden_at_first_where_enough_is_left_from_everywhere():
    at, inwards = box()
    sides = sides_seen(inwards, -at, certain=True)
    wall = inwards[:, 0] < 0
    assert hides_well(sides) and not hides_well(sides[wall]) and not hides_well(np.zeros_like(sides))


def test_a_ray_from_outside_meets_the_far_wall():
    at, inwards = box()
    sides, eye, way = sides_seen(inwards, -at, certain=True), np.array([9.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    at = at.astype(np.float32)
    assert at[pick(at, eye, way, cone_rad=0.05)][0] == pytest.approx(ROOM_M[0])
    assert at[pick(at, eye, way, cone_rad=0.05, sides=sides)][0] == pytest.approx(-ROOM_M[0])
    only = inwards[:, 0] < 0
    assert pick(at[only], eye, way, cone_rad=0.05, sides=sides[only]) is None
    assert seen_from(sides, at, np.zeros(3)).all() and seen_from(0 * sides, at, eye).all()


def test_a_scanned_room_knows_its_sides(room):
    shown = ShownCloud(room.name, room.cloud, middle_of(room.cloud))
    assert shown.hides and len(shown.sides) == shown.points
    scanner = shown.stations()[0]
    assert seen_from(shown.sides, shown.xyz, scanner).mean() > 0.99
    above = shown.high * [0, 0, 1] + [0, 0, 5]
    ceiling = shown.xyz[:, 2] > shown.high[2] - 0.02
    assert not seen_from(shown.sides, shown.xyz, above)[ceiling].mean() > 0.2


def stripped(cloud):
    """The cloud as other scanners' files have it: a grid, and no normals."""
    return dataclasses.replace(cloud, normals=np.zeros_like(cloud.normals))


def test_a_grid_without_normals_knows_the_same_sides(room):
    cloud = stripped(room.cloud)
    shown, own = ShownCloud("", cloud, middle_of(cloud)), ShownCloud("", room.cloud, middle_of(cloud))
    assert shown.hides and not shown.has("normals")
    a, b = shown.sides.astype(float), own.sides.astype(float)
    both = np.any(a != 0, 1) & np.any(b != 0, 1)
    assert both.mean() > 0.9
    cosine = np.einsum("ni,ni->n", a[both], b[both]) / 127**2
    # Those at edges take other neighbours without the sigmas of rows.
    assert np.mean(cosine > 0.95) > 0.95


def test_a_grid_on_a_map_and_places_where_no_scanner_stood(room):
    cloud, here = stripped(room.cloud), np.zeros((len(room.cloud.valid), 3))
    found, map_m = gridded_normals(cloud, here), np.array([400_000.0, 5_800_000.0, 100.0])
    far = dataclasses.replace(cloud, xyz=np.where(cloud.valid[..., None], cloud.xyz.astype(np.float64) + map_m, 0.0))
    cosine = np.einsum("ijk,ijk->ij", gridded_normals(far, here + map_m), found)[np.any(found != 0, -1)]
    assert np.mean(cosine > 0.999) > 0.99
    assert gridded_normals(cloud, here + [1.5, 0.5, 0.0]) is None
    few = jax.tree.map(lambda field: field[:2], cloud)
    assert gridded_normals(few, here[:2]) is None
