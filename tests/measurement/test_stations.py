"""Measurements in the joined cloud of two stations: the pose of the second counts."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.geometry import exponential
from jaxscan.measurement import compare_clouds, measure_distance, measure_plane
from jaxscan.reconstruction import PointCloud, join_clouds


SECOND = np.asarray(exponential(jnp.array([2.0, 0.5, 0.0, 0.0, 0.0, 2.0])))
SIGMAS = np.array([2e-4, 3e-4, 1e-4, 5e-5, 8e-5, 3e-4])
COVARIANCE = np.diag(SIGMAS**2)


def patch_at(room_point, T) -> PointCloud:
    """A square of 4 cm parallel to y and z about a point of the room, in the frame of a station; no calibration."""
    y, z = np.meshgrid(np.linspace(-0.02, 0.02, 9), np.linspace(-0.02, 0.02, 9))
    p = np.asarray(room_point) + np.stack([0 * y, y, z], -1)
    local = (p - T[:3, 3]) @ T[:3, :3]
    grid = y.shape
    return PointCloud(
        xyz=local,
        rgb=np.zeros((*grid, 3), np.uint8),
        intensity=np.ones(grid),
        normals=np.zeros((*grid, 3)),
        sigma_random=np.full(grid, 1e-4),
        sigma_systematic=np.zeros(grid),
        valid=np.ones(grid, bool),
        record=np.arange(9, dtype=np.int32),
        laser=np.zeros(9, np.int32),
        angle=np.zeros(9),
    )


A, B = (-1.5, 0.3, 0.2), (3.6, 0.9, -0.4)


def joined(T, covariance=COVARIANCE):
    parts = patch_at(A, np.eye(4)), patch_at(B, SECOND)
    return join_clouds(parts, [np.eye(4), T], [np.zeros((6, 6)), covariance])


def test_a_distance_between_stations_has_the_sigma_of_the_pose():
    found = measure_distance(joined(SECOND), A, B, radius_m=0.05)
    rng, values = np.random.default_rng(3), []
    for _ in range(150):
        T = SECOND @ np.asarray(exponential(jnp.asarray(SIGMAS * rng.normal(size=6))))
        values.append(measure_distance(joined(T), A, B, radius_m=0.05).value_m)
    # 150 draws: 5.8 %; three of those.
    assert found.sigma_systematic_m == pytest.approx(np.std(values), rel=0.18)
    assert found.value_m == pytest.approx(np.linalg.norm(np.subtract(A, B)), abs=1e-9)


def test_within_a_station_the_pose_does_not_count():
    """Both patches move alike."""
    near = np.add(B, (0.0, 0.4, 0.0))
    parts = patch_at(A, np.eye(4)), patch_at(B, SECOND), patch_at(near, SECOND)
    both = [np.concatenate([getattr(part, name) for part in parts[1:]]) for name in vars(parts[1]) if name not in NONE]
    second = PointCloud(**dict(zip((name for name in vars(parts[1]) if name not in NONE), both, strict=True)))
    cloud = join_clouds([parts[0], second], [np.eye(4), SECOND], [np.zeros((6, 6)), COVARIANCE])
    assert measure_distance(cloud, B, near, radius_m=0.05).sigma_systematic_m < 1e-9


NONE = ("sigma_row", "shift_px", "shared_lines", "stations", "absent")


def test_rays_and_normals_start_at_the_station():
    """The patch at x = 3.6 is seen from this side by a station at x = 2, and from beyond by one at x = 5."""
    behind = SECOND.copy()
    behind[0, 3] = 5.0
    parts = patch_at(A, np.eye(4)), patch_at(B, behind)
    seen = join_clouds(parts, [np.eye(4), behind], [np.zeros((6, 6))] * 2)
    assert measure_plane(joined(SECOND), B, radius_m=0.05).normal[0] == pytest.approx(-1.0)
    assert measure_plane(seen, B, radius_m=0.05).normal[0] == pytest.approx(1.0)


def test_errors_along_the_ray_are_those_of_the_station():
    """The calibration of a cloud without a scanner: rays start at the station's origin."""
    truth, cloud = joined(SECOND), joined(SECOND)
    own = (np.asarray(B) - SECOND[:3, 3]) / np.linalg.norm(np.asarray(B) - SECOND[:3, 3])
    cloud.xyz[9:] += 1e-3 * own
    found = compare_clouds(cloud, truth)
    # The patch is 1.7 m away: its rays differ by 2 cm in that.
    assert found.along_ray_m.max_abs == pytest.approx(1e-3, rel=1e-3)
