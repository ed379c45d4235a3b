"""Distances, flatness and comparisons against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxscan.errors import MeasurementError
from jaxscan.measurement import compare_clouds, measure_distance, measure_plane, measure_points


def wall_cloud(depth, noise=1e-3, seed=0, shape=(200, 100)):
    """Points x = depth(y, z) on a fine grid seen from the origin, noise along x."""
    y, z = np.meshgrid(np.linspace(-1, 1, shape[0]), np.linspace(-0.5, 0.5, shape[1]), indexing="ij")
    x = depth(y, z) + noise * np.random.default_rng(seed).normal(size=shape)
    return SimpleNamespace(
        xyz=np.stack([x, y, z], -1).astype(np.float32),
        sigma_random=np.full(shape, noise, np.float32),
        valid=np.ones(shape, bool),
        laser=np.zeros(shape[0], np.int32),
        angle=np.zeros(shape[0]),
    )


def test_distance_on_a_step():
    cloud = wall_cloud(lambda y, z: np.where(y < 0, 2.5, 2.2))
    found = measure_distance(cloud, [2.5, -0.03, 0.0], [2.2, 0.03, 0.0], radius_m=0.025)
    assert found.plane_to_plane_m == pytest.approx(0.3, abs=5 * found.plane_to_plane_sigma_m)
    assert found.value_m == pytest.approx(np.hypot(0.3, 0.06), abs=2e-3)


def test_sigma_of_a_distance_is_honest():
    whitened = []
    for seed in range(60):
        cloud = wall_cloud(lambda y, z: np.where(y < 0, 2.5, 2.2), seed=seed, noise=2e-3, shape=(100, 50))
        found = measure_distance(cloud, [2.5, -0.11, 0.0], [2.2, 0.11, 0.0], radius_m=0.1)
        whitened.append((found.plane_to_plane_m - 0.3) / found.plane_to_plane_sigma_m)
    # 60 values: a root mean square within 1 +- 3 / sqrt(120).
    assert np.sqrt(np.mean(np.square(whitened))) == pytest.approx(1.0, abs=0.28)


def test_flatness():
    cloud = wall_cloud(lambda y, z: 2.0 + 0.2 * y, noise=1e-3)
    found = measure_plane(cloud, [2.0, 0.0, 0.0], radius_m=0.3)
    slope = np.array([-1.0, 0.2, 0.0]) / np.hypot(1.0, 0.2)
    np.testing.assert_allclose(found.normal, slope, atol=1e-3)
    # Noise along x, measured across the plane; 1400 points give an RMS to 2 %.
    expected = 1e-3 / np.hypot(1.0, 0.2)
    assert found.rms_m == pytest.approx(expected, rel=0.08)
    assert found.range95_m == pytest.approx(2 * 1.96 * expected, rel=0.1)


def test_refusals():
    cloud = wall_cloud(lambda y, z: 2.0 + 0 * y)
    with pytest.raises(
        MeasurementError, match=r"Only 0 points lie within 0.02 m of \(5.000, 0.000, 0.000\), the nearest 2.998 m away"
    ):
        measure_distance(cloud, [5.0, 0.0, 0.0], [2.0, 0.0, 0.0])
    with pytest.raises(MeasurementError, match="farther apart"):
        measure_distance(cloud, [2.0, 0.0, 0.0], [2.0, 0.01, 0.0])
    cloud.valid[:, 1:] = False
    with pytest.raises(MeasurementError, match="determine no plane"):
        measure_plane(cloud, [2.0, 0.0, -0.5], radius_m=0.3)


def test_compare_on_one_grid():
    truth = wall_cloud(lambda y, z: 2.5 + 0 * y, noise=0.0)
    cloud = wall_cloud(lambda y, z: 2.5 + 0 * y, noise=2e-3)
    # Move every point along its own ray.
    rays = truth.xyz / np.linalg.norm(truth.xyz, axis=-1, keepdims=True)
    error = (cloud.xyz - truth.xyz)[..., :1]
    cloud.xyz = truth.xyz + error * rays
    cloud.valid[:50], truth.valid[:20] = False, False
    cloud.xyz[:50] = np.nan
    cloud.valid[:5] = True
    cloud.xyz[:5] = 1.0
    found = compare_clouds(cloud, truth)
    assert found.completeness == pytest.approx(150 / 180) and found.false_points == 5 * 100
    # 15 000 points: 0.6 %.
    assert found.along_ray_m.rms == pytest.approx(2e-3, rel=0.03)
    assert found.whitened.rms == pytest.approx(1.0, rel=0.03)
    assert found.error_m.median_abs == pytest.approx(0.6745 * 2e-3, rel=0.04)
    assert found.error_m.p95_abs == pytest.approx(1.96 * 2e-3, rel=0.04)


def test_a_true_point_at_the_camera_has_no_ray():
    truth = wall_cloud(lambda y, z: 0 * y + 2.0, noise=0)
    cloud = wall_cloud(lambda y, z: 0 * y + 2.0)
    without = compare_clouds(cloud, truth).along_ray_m
    truth.xyz[3, 5] = cloud.xyz[3, 5] = 0
    found = compare_clouds(cloud, truth)
    assert all(np.isfinite(list(vars(one).values())).all() for one in (found.along_ray_m, found.whitened))
    # One of 20,000 errors of 1 mm is missing.
    assert found.along_ray_m.rms == pytest.approx(without.rms, rel=1e-3)
    truth.xyz[:] = 0
    assert compare_clouds(cloud, truth).along_ray_m is None


def test_compare_without_a_grid():
    truth = wall_cloud(lambda y, z: 2.5 + 0 * y, noise=0.0, shape=(200, 100))
    cloud = wall_cloud(lambda y, z: 2.503 + 0 * y, noise=0.0, shape=(150, 90))
    cloud.valid[75:] = False
    found = compare_clouds(cloud, truth)
    assert found.along_ray_m is None and found.points == 75 * 90
    # 3 mm across and at most half a cell of 10 mm along the wall.
    assert 3e-3 <= found.error_m.median_abs < 8e-3
    assert found.completeness == pytest.approx(0.5, abs=0.02)
    cloud.valid[:] = False
    with pytest.raises(MeasurementError, match="The cloud has no valid points"):
        compare_clouds(cloud, truth)


def test_a_distance_that_is_noise_is_not_stated():
    cloud = wall_cloud(lambda y, z: np.full_like(y, 2.5), noise=0.05)
    a, b = np.array([2.5, 0.0, 0.0]), np.array([2.5, 0.1, 0.0])
    with pytest.raises(MeasurementError, match=r"^The distance is not known: .* expected at most 20 % of it"):
        measure_points(cloud, a, b + [0.2, 0, 0], within_m=0.5)
    assert measure_distance(cloud, a, b + [0, 0.4, 0], radius_m=0.05).sigma_m < 0.02
