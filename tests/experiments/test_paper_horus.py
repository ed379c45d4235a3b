"""The re-implementation of a desk scanner's method, against closed forms."""

import numpy as np
import pytest

from experiments.paper import methods


def _circle(radius: float, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a circle in a slanted plane, its centre and its normal."""
    normal = np.array([0.1, -0.97, 0.2]) / np.linalg.norm([0.1, -0.97, 0.2])
    first = np.cross(normal, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    second, centre = np.cross(normal, first), np.array([0.02, 0.3, -0.2])
    points = centre + radius * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
    return points, centre, normal


def test_a_circle_is_found_from_a_short_arc():
    points, centre, normal = _circle(1.4, np.deg2rad(np.linspace(10, 34, 9)))
    seen, middle, radius = methods.fit_circle(points)
    assert radius == pytest.approx(1.4, abs=1e-9)
    np.testing.assert_allclose(middle, centre, atol=1e-9)
    assert abs(seen @ normal) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("sense", [1, -1])
def test_the_axis_turns_as_the_camera_does(sense: int):
    angles = np.deg2rad(np.linspace(-12, 12, 9))
    # Seen from a camera that turns by phi, the room turns by -phi.
    points, centre, normal = _circle(2.0, -sense * angles)
    direction, point = methods.axis_of(angles, points)
    np.testing.assert_allclose(direction, sense * normal, atol=1e-9)
    np.testing.assert_allclose(point, centre, atol=1e-8)


def test_one_sided_outliers_do_not_move_the_plane():
    random = np.random.default_rng(3)
    normal, distance = np.array([0.97, 0.21, -0.12]) / np.linalg.norm([0.97, 0.21, -0.12]), 0.165
    y, z = random.uniform(-0.3, 0.3, 2000), random.uniform(0.9, 3.0, 2000)
    points = np.column_stack([(distance - normal[1] * y - normal[2] * z) / normal[0], y, z])
    points += 2e-4 * random.standard_normal(points.shape)
    points[:600] += 0.08 * normal
    found, at = methods.ransac_plane(points, random)
    sign = np.sign(found @ normal)
    np.testing.assert_allclose(sign * found, normal, atol=1e-4)
    assert sign * at == pytest.approx(distance, abs=1e-4)


def _frames(u: np.ndarray, peak: float) -> tuple[np.ndarray, np.ndarray]:
    """A stripe of 1.5 px (standard deviation) without noise on a grey room."""
    columns = np.arange(120)
    off = np.full((len(u), 120), 40, np.uint8)
    light = peak * np.exp(-0.5 * ((columns - u[:, None]) / 1.5) ** 2)
    return np.round(off + light).astype(np.uint8), off


def test_the_centroid_of_a_clean_stripe_errs_by_its_threshold_alone():
    u = 60 + 0.01 * np.arange(200)
    found, valid = methods.horus_centres(*_frames(u, 150.0))
    assert valid.all()
    # A stripe on a pixel, or between two, is symmetric: nothing is cut from one side alone.
    np.testing.assert_allclose(found[[0, 50, 100, 150]], u[[0, 50, 100, 150]], atol=0.03)
    # Elsewhere the threshold cuts a pixel more from one side; over whole pixels that cancels.
    error = found - u
    assert abs(error.mean()) < 0.02
    assert 0.02 < error.std() < 0.15
    # Nothing is cut without a threshold: the centre of gravity is exact but for whole codes.
    on, off = _frames(u, 150.0)
    light = on - off
    whole, _ = methods.centroid(light, light.argmax(1), methods.HORUS_REACH, 0)
    np.testing.assert_allclose(whole, u, atol=0.02)


def test_a_faint_stripe_is_lost_as_shipped_and_found_when_tuned():
    frames = _frames(np.full(50, 60.5), 45.0)
    assert not methods.horus_scan(*frames)[1].any()
    u, valid = methods.horus_tuned(*frames)
    assert valid.all()
    np.testing.assert_allclose(u, 60.5, atol=0.03)


def test_smoothing_stays_within_unbroken_segments():
    u, valid = np.concatenate([np.full(30, 20.0), np.full(5, -1.0), np.full(30, 50.0)]), np.ones(65, bool)
    valid[30:35] = False
    out = methods.smoothed(u, valid)
    np.testing.assert_allclose(out[valid], u[valid], atol=1e-12)


def test_strays_do_not_bend_the_straight_line():
    v = np.arange(100.0)
    uv = np.column_stack([300 - 0.05 * v, v])
    uv[::9, 0] += 12
    line = methods.straightened(uv)
    np.testing.assert_allclose(line[:, 0], 300 - 0.05 * line[:, 1], atol=1e-9)
    assert len(line) == 100 - len(v[::9])


def test_points_of_the_sheet_lie_on_it_and_turn_about_the_axis():
    normal = np.array([-0.96, -0.2, 0.13]) / np.linalg.norm([-0.96, -0.2, 0.13])
    lens = np.array([-0.1, 0.08, 0.0, 0.0, 0.0])
    matrix = np.array([[720.0, 0, 254], [0, 720, 204], [0, 0, 1]])
    direction, point = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -0.21])
    rig = methods.Horus(matrix, lens, normal, 0.165, normal, 0.165, direction, point)
    u, valid = np.full((3, 400), 300.0), np.ones((3, 400), bool)
    valid[:, 7] = False
    still = methods.horus_points(rig, np.stack([u[0], np.arange(400.0)], -1))
    np.testing.assert_allclose(still @ normal, 0.165, atol=1e-12)
    cloud = methods.horus_cloud(rig, u, valid, np.array([0.0, 0.5, np.pi]))
    assert np.isnan(cloud[:, 7]).all()
    keep = np.arange(400) != 7
    np.testing.assert_allclose(cloud[0, keep], still[keep], atol=1e-12)
    # Half a turn about an upright axis.
    np.testing.assert_allclose(cloud[2, keep] - point, (still[keep] - point) * [-1, 1, -1], atol=1e-12)
    # Corrected, a point is on the sheet again.
    flat = methods.horus_points(rig, np.array([[300.0, 390.0]]), lens=True)
    np.testing.assert_allclose(flat @ normal, 0.165, atol=1e-12)
    assert np.linalg.norm(flat - still[390]) > 1e-3
