"""Planes and their points, in sweeps of known rooms."""

import numpy as np
import pytest

from jaxscan.errors import CalibrationError
from jaxscan.recalibration import SurfacePoints, Surfaces
from jaxscan.recalibration.segment import label_planes, observe_surfaces
from jaxscan.recalibration.triangulate import triangulate_points
from tests.recalibration.faces import Cylinder, Face, Taken, X, Y, Z, box, poor, rig, take


HOME = np.eye(4)[None]


def faces_of(taken: Taken, points: SurfacePoints) -> np.ndarray:
    return taken.face[points.record, points.line]


def shares(taken: Taken, points: SurfacePoints, surfaces: Surfaces) -> list[np.ndarray]:
    """How many points of each surface lie on each face."""
    face = faces_of(taken, points)
    return [np.bincount(face[points.surface == k], minlength=12) for k in range(len(surfaces.distance))]


def assert_pure(taken: Taken, points: SurfacePoints, surfaces: Surfaces) -> None:
    for count in shares(taken, points, surfaces):
        # A stripe in the noise beside an edge may lie on the other face.
        assert count.max() >= 0.995 * count.sum(), count


@pytest.mark.more
@pytest.mark.parametrize("radius", [1.0, 5.0])
@pytest.mark.parametrize("known", [True, False])
def test_a_curved_wall_is_no_plane(radius, known):
    stored, true = (rig(), rig()) if known else poor(5)
    # 1.4 m of the wall x = -2 bulge outwards.
    half = 0.7
    depth = radius - np.sqrt(radius**2 - half**2)
    bulge = Cylinder((-2.0 - depth + radius, 0.0), radius, ((X, -9.0, -2.0),))
    flat = [Face(X, -2.0, ((Y, half, 9.0),)), Face(X, -2.0, ((Y, -9.0, -half),))]
    taken = take([bulge, *flat, *box()[1:]], true)
    points, surfaces = observe_surfaces([taken.sweep], stored, HOME)
    face = faces_of(taken, points)
    assert (taken.face == 0).sum() > 3000
    assert (face == 0).sum() == 0
    for number in (3, 4, 5):
        assert (face == number).sum() > 1000
    assert_pure(taken, points, surfaces)


@pytest.mark.more
@pytest.mark.parametrize("known", [True, False])
def test_a_wall_with_a_step_is_two_planes(known):
    stored, true = (rig(), rig()) if known else poor(2)
    wall = [Face(X, -2.0, ((Y, -9.0, 0.3),)), Face(X, -2.005, ((Y, 0.3, 9.0),))]
    taken = take([*wall, *box()[1:]], true)
    points, surfaces = observe_surfaces([taken.sweep], stored, HOME)
    assert_pure(taken, points, surfaces)
    for number in (0, 1):
        assert (faces_of(taken, points) == number).sum() > 1000


def test_a_panel_on_a_wall_is_not_the_wall():
    panel = Face(X, -1.995, ((Y, -0.5, 0.5), (Z, -0.4, 0.3)))
    taken = take([panel, *box()], rig())
    points, surfaces = observe_surfaces([taken.sweep], rig(), HOME)
    assert_pure(taken, points, surfaces)
    assert (faces_of(taken, points) == 0).sum() > 300


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.more) for seed in (2, 3))])
def test_walls_that_a_poor_calibration_bends_are_planes(seed):
    stored, true = poor(seed)
    taken = take(box(), true)
    points, surfaces = observe_surfaces([taken.sweep], stored, HOME)
    assert_pure(taken, points, surfaces)
    counts = shares(taken, points, surfaces)
    for wall in range(4):
        assert sum(count.argmax() == wall for count in counts) == 1
        own = np.flatnonzero([count.argmax() == wall for count in counts])[0]
        # The wall from end to end, less its corners.
        records = points.record[points.surface == own]
        seen = np.flatnonzero((taken.face == wall).sum(1) > 300)
        assert len(np.intersect1d(records, seen)) > 0.85 * len(seen)


def test_a_poor_calibration_bends_walls_by_millimetres():
    stored, true = poor(1)
    taken = take(box(), true, noise_px=1e-6)
    labels = label_planes(taken.sweep, stored)
    worst = []
    for k in range(4):
        profile, line = np.nonzero(labels == k)
        q = np.stack([taken.sweep.centre[profile, line], line], -1)
        p, _ = triangulate_points(stored, q, np.zeros(len(q), int), taken.sweep.angle[profile])
        p = p - p.mean(0)
        worst.append(np.abs(p @ np.linalg.eigh(p.T @ p)[1][:, 0]).max())
    # More than a wall may be uneven: without the covariance there would be no planes.
    assert max(worst) > 3e-3


def test_parts_of_a_wall_behind_furniture_and_at_the_end_of_the_turn_are_one():
    cupboard = Face(X, -1.5, ((Y, -0.5, 0.4),))
    taken = take([*box(), cupboard], rig(), steps=390, turn=np.deg2rad(390))
    points, surfaces = observe_surfaces([taken.sweep], rig(), HOME)
    counts = shares(taken, points, surfaces)
    assert sorted(count.argmax() for count in counts) == [0, 1, 2, 3, 6]
    behind = points.take(faces_of(taken, points) == 0)
    middle = np.flatnonzero((taken.face == 6).any(1)).mean()
    assert min((behind.record < middle).sum(), (behind.record > middle).sum()) > 500
    ahead = points.take(faces_of(taken, points) == 1)
    # Seen at the start, and again beyond the full turn.
    assert (ahead.record < 30).sum() > 300
    assert (ahead.record >= 360).sum() > 300


@pytest.mark.more
def test_two_stations_see_one_wall():
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]
    pose[:3, 3] = 0.5, -0.4, 0.02
    one, two = take(box(), rig(), seed=1), take(box(), rig(), seed=2, pose=pose, station=1)
    points, surfaces = observe_surfaces([one.sweep, two.sweep], rig(), np.stack([np.eye(4), pose]))
    for k in range(len(surfaces.distance)):
        own = points.take(points.surface == k)
        face = np.where(own.sweep == 0, one.face[own.record, own.line], two.face[own.record, own.line])
        assert len(np.unique(face)) == 1
    walls = [points.take(points.surface == k) for k in range(4)]
    assert all((wall.sweep == 0).sum() > 1000 and (wall.sweep == 1).sum() > 1000 for wall in walls)
    # Planes in the frame of the room, towards the scanner: to the noise of means of thousands of points.
    for k in range(4):
        axis = int(np.argmax(np.abs(surfaces.normal[k])))
        side = -2.0, 2.2, -2.1, 2.4
        at = surfaces.distance[k] / surfaces.normal[k, axis]
        assert min(abs(at - wall) for wall in side) < 5e-4


def test_points_are_few_independent_and_even():
    taken = take(box(), rig())
    shared = 6.0 * np.ones_like(taken.sweep.shared_lines)
    sweep = taken.sweep._replace(shared_lines=shared)
    points, surfaces = observe_surfaces([sweep], rig(), HOME, 5000)
    assert 4500 < len(points.q) <= 5000
    order = np.lexsort((points.line, points.record))
    record, line = points.record[order], points.line[order]
    assert (np.diff(line)[np.diff(record) == 0] >= 6).all()
    counts = np.bincount(points.surface)
    assert counts[:4].min() > 0.7 * counts[:4].max()
    # A wall seen at 45 degrees has fewer profiles to the metre; its points are as dense.
    wall = points.take(points.surface == int(np.argmax(-surfaces.normal[:, 0])))
    angle = np.deg2rad(wall.record.astype(float))
    along = 2.2 * np.tan((angle + np.pi) % (2 * np.pi) - np.pi)
    middle, end = (np.abs(along) < 0.5).sum() / 1.0, ((along > 0.8) & (along < 1.6)).sum() / 0.8
    assert 0.6 < end / middle < 1.7
    assert (taken.sweep.centre[points.record, points.line] == points.q[:, 0]).all()


def test_corners_are_left_out():
    taken = take(box(), rig(), noise_px=0.02)
    points, _ = observe_surfaces([taken.sweep], rig(), HOME)
    p, _ = triangulate_points(rig(), points.q, points.laser, taken.sweep.angle[points.record])
    face = faces_of(taken, points)
    upright = np.stack([p[:, 0] + 2.0, 2.2 - p[:, 0], p[:, 1] + 2.1, 2.4 - p[:, 1]], -1)
    own = np.arange(4) == face[:, None]
    # 20 cm, less the noise of a stripe.
    assert np.where(own, np.inf, upright)[face < 4].min() > 0.19
    level = np.minimum(p[:, 2] + 0.75, 0.8 - p[:, 2])[face < 4]
    assert level.min() > 0.01
    assert np.where(own, np.inf, upright).min(1)[face < 4].min() < 0.3


def test_labels_lie_on_planes():
    taken = take(box(), rig())
    labels = label_planes(taken.sweep, rig())
    assert labels.shape == taken.face.shape
    assert (labels[taken.face < 0] == -1).all()
    for k in range(labels.max() + 1):
        assert len(np.unique(taken.face[labels == k])) == 1
    assert (labels >= 0).mean() > 0.7


def test_lines_without_stripes_and_two_lasers():
    taken = take(box(), rig())
    valid = taken.sweep.valid.copy()
    valid[:, 1::2] = False
    points, surfaces = observe_surfaces([taken.sweep._replace(valid=valid)], rig(), HOME)
    assert (points.line % 2 == 0).all()
    assert_pure(taken, points, surfaces)
    assert len(points.q) > 10_000


def test_a_sweep_without_planes_is_refused():
    taken = take([Cylinder((0.1, 0.2), 2.0)], rig())
    with pytest.raises(CalibrationError, match=r"sweep 0: found no plane, expected .*: sweep a room"):
        observe_surfaces([taken.sweep], rig(), HOME)
    nothing = taken.sweep._replace(valid=np.zeros_like(taken.sweep.valid))
    with pytest.raises(CalibrationError, match="found no plane"):
        label_planes(nothing, rig())
