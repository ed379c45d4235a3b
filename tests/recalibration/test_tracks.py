"""Key images, prediction on the unrolled image, triangulation and the test of consistency, on exact numbers."""

import numpy as np
import pytest

from jaxscan.recalibration import Tracks
from jaxscan.recalibration.tracks import named_points, place_tracks
from jaxscan.recalibration.tracks.observe import Turning, choose_keys, unroll
from jaxscan.recalibration.tracks.points import Sightings, keep_consistent, project_all, rays_of, triangulate
from tests.vision.painted_room import Rig, pixel
from tests.vision.room_capture import stripes_of, true_scanner


RIG = Rig()
SCANNER = true_scanner(RIG)


def still(count):
    return np.broadcast_to(np.eye(4), (count, 4, 4))


def seen_points(rng, tracks=120, views=7, noise=0.0):
    """Points in front of the camera at all angles, and their exact pixels by formulas of the tests' own."""
    first = rng.uniform(0, 2 * np.pi, tracks)
    angle = (first[:, None] + np.linspace(-0.3, 0.3, views)).ravel()
    track = np.repeat(np.arange(tracks), views)
    point = np.empty((tracks, 3))
    for k in range(tracks):
        ray = rays_of(SCANNER, rng.uniform([60, 20], [140, 140], (1, 2)), first[k : k + 1], still(1))
        point[k] = ray.origin[0] + rng.uniform(1.0, 4.0) * ray.direction[0]
    pose = np.asarray(SCANNER.scanner_from_camera())
    camera = (point - pose[:3, 3]) @ pose[:3, :3]
    q = np.concatenate([pixel(RIG, camera[t][None], a) for t, a in zip(track, angle, strict=True)])
    return point, Sightings(
        q + noise * rng.standard_normal(q.shape),
        np.full(len(q), noise or 0.1),
        angle,
        np.tile(np.arange(views), tracks),
        track,
        np.zeros(len(q), int),
    )


def test_projection_is_that_of_other_formulas():
    point, seen = seen_points(np.random.default_rng(0), 5)
    assert project_all(SCANNER, point[seen.track], seen.angle, still(len(seen.q))) == pytest.approx(seen.q, abs=1e-9)


def test_exact_sightings_give_the_points():
    point, seen = seen_points(np.random.default_rng(1))
    rays = rays_of(SCANNER, seen.q, seen.angle, still(len(seen.q)))
    found = triangulate(rays, np.full(len(seen.q), 1e-3), seen.track, len(point))
    assert found.valid.all()
    # The regularisation of points that a camera on the axis cannot place moves others by some micrometres.
    assert found.point == pytest.approx(point, abs=1e-5)


def test_the_covariance_of_points_is_that_of_many_draws():
    rng = np.random.default_rng(2)
    point, seen = seen_points(rng, 1)
    many, sigma = 400, 0.2
    q = np.tile(seen.q, (many, 1)) + sigma * rng.standard_normal((many * len(seen.q), 2))
    rays = rays_of(SCANNER, q, np.tile(seen.angle, many), still(len(q)))
    found = triangulate(rays, np.full(len(q), sigma / RIG.focal), np.repeat(np.arange(many), len(seen.q)), many)
    chi2 = np.einsum("ni,nij,nj->n", found.point - point, np.linalg.inv(found.covariance), found.point - point)
    # Three degrees of freedom; the mean of 400 has a standard deviation of 0.12, and the lens's edges are magnified.
    assert chi2.mean() == pytest.approx(3.0, abs=0.7)


def test_points_behind_the_camera_and_far_away_are_no_points():
    angle = np.array([0.0, 0.2, 0.4])
    pose = np.asarray(SCANNER.scanner_from_camera())
    ahead = rays_of(SCANNER, np.tile(RIG.centre, (1, 1)), np.array([0.2]), still(1))
    places = np.concatenate([ahead.origin + d * ahead.direction for d in (2.0, 60.0)])
    camera = (places - pose[:3, 3]) @ pose[:3, :3]
    q = np.concatenate([[pixel(RIG, p[None], a)[0] for a in angle] for p in camera])
    # Turned the other way round, the rays of the first point meet behind the camera.
    rays = rays_of(SCANNER, np.concatenate([q, q[2::-1]]), np.tile(angle, 3), still(9))
    found = triangulate(rays, np.full(9, 1e-3), np.repeat([0, 1, 2], 3), 3)
    assert found.valid.tolist() == [True, False, False]


def test_unrolled_images_know_their_pixels():
    cylinder = unroll(SCANNER, (RIG.width, RIG.height))
    row, column = np.nonzero(cylinder.u >= 0)
    # All of the image but a border of one cell.
    u, v = cylinder.u[row, column], cylinder.v[row, column]
    assert max(u.min(), v.min(), RIG.width - 1 - u.max(), RIG.height - 1 - v.max()) < 5.0
    some = np.random.default_rng(3).choice(len(row), 200)
    q = np.stack([cylinder.u[row[some], column[some]], cylinder.v[row[some], column[some]]], -1)
    direction = rays_of(SCANNER, q, np.zeros(200), still(200)).direction
    place = Turning.of(SCANNER, cylinder.scale).place(direction)
    expected = np.stack([column[some] + cylinder.left, row[some] + cylinder.top], -1)
    # Pixels are linear between places 4 px apart: the bend of a lens of 150 px within them.
    assert place == pytest.approx(expected, abs=0.03)


def test_a_prediction_is_where_the_point_is_seen():
    point, seen = seen_points(np.random.default_rng(4), 30, 2)
    turning = Turning.of(SCANNER, RIG.focal)
    rays = rays_of(SCANNER, seen.q, np.zeros(len(seen.q)), still(len(seen.q)))
    place = turning.place(rays.direction).reshape(-1, 2, 2)
    angle = seen.angle.reshape(-1, 2)
    for k, p in enumerate(point):
        ray = rays_of(SCANNER, seen.q[2 * k : 2 * k + 1], angle[k, :1], still(1))
        across = np.linalg.norm((p - ray.origin[0])[:2])
        there = turning.predict(place[k, :1], float(angle[k, 1] - angle[k, 0]), across)
        assert there[0] == pytest.approx(place[k, 1], abs=1e-6)


def test_key_images_are_even_and_close_the_turn():
    heading = np.radians(np.arange(0.0, 390.0, 0.1))
    keys = choose_keys(heading, np.radians(40.0))
    assert len(keys.record) == 120
    gaps = np.degrees(np.diff(keys.heading))
    assert gaps.max() - gaps.min() < 0.2
    # After the last one, at 390 degrees, come those from 30 degrees on.
    assert np.degrees(keys.heading[keys.closing[0]]) == pytest.approx(30.0, abs=gaps.max())


def test_a_part_of_a_turn_is_not_closed():
    assert len(choose_keys(np.radians(np.arange(0.0, 270.0, 2.0)), np.radians(40.0)).closing) == 0


@pytest.mark.parametrize("heading", [[], [0.0], [0.0, 0.1], [1.0] * 9, np.arange(0.0, 6.0, 0.5)])
def test_too_few_or_too_distant_images_are_no_key_images(heading):
    assert choose_keys(np.array(heading), np.radians(40.0)) is None


def test_wrong_sightings_are_left_out_and_the_noise_is_learned():
    rng = np.random.default_rng(6)
    _, seen = seen_points(rng, 200, 7, noise=0.3)
    names = SCANNER.parameter_names()
    step = np.zeros(len(names))
    step[names.index("fx")], step[names.index("cx")], step[names.index("gain")] = 0.5, -1.0, 1e-3
    wrong = seen.track % 10 == 0
    q = seen.q.copy()
    q[wrong] += rng.uniform(-30, 30, (wrong.sum(), 2))
    single = (seen.track % 10 == 1) & (seen.key == 3)
    q[single] += 8.0
    # The finder is three times too sure.
    tested = keep_consistent(SCANNER.retract(step), seen._replace(q=q, sigma=seen.sigma / 3))
    assert not tested.kept[wrong].any()
    assert not tested.kept[single].any()
    # One gross error may throw a whole track behind the camera.
    good = seen.track % 10 > 1
    assert tested.kept[good].mean() > 0.97
    assert np.median(tested.sigma[good]) == pytest.approx(0.3, rel=0.1)


def test_what_turns_with_the_camera_is_no_point():
    _, seen = seen_points(np.random.default_rng(7), 100, 7, noise=0.1)
    turning = seen.track < 20
    q = np.where(turning[:, None], seen.q[seen.track * 7], seen.q)
    assert not keep_consistent(SCANNER, seen._replace(q=q)).kept[turning].any()


def test_points_come_into_the_room_with_their_stations():
    point, seen = seen_points(np.random.default_rng(8), 6, 5)
    count = len(seen.q)
    stations = np.stack([np.eye(4), np.eye(4)])
    stations[1, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    stations[1, :3, 3] = [2.0, 0.5, -0.1]
    sweeps = [stripes_of(seen.angle), stripes_of(seen.angle, "b", station=1)]
    record, zero = np.arange(count), np.zeros(count, int)
    names = ("", "", "", "", "marker 1 corner 0", "marker 1 corner 1")
    tracks = Tracks(seen.q, np.full(count, 0.1), zero + 1, record, seen.track, np.zeros((6, 3)), names)
    placed = place_tracks(tracks, sweeps, SCANNER, stations)
    assert placed.point == pytest.approx(point @ stations[1, :3, :3].T + stations[1, :3, 3], abs=1e-6)
    named = named_points(placed, 1, sweeps, SCANNER)
    assert set(named) == {"marker 1 corner 0", "marker 1 corner 1"}
    assert named["marker 1 corner 1"][0] == pytest.approx(point[5], abs=1e-6)
    assert named_points(placed, 0, sweeps, SCANNER) == {}
