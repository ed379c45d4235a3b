"""Rooms with known walls: exact dimensions, furniture, honest sigmas."""

from dataclasses import astuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import MeasurementError
from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.measurement import measure_room


SIZE = (6.15, 3.82, 2.6)


def values(room):
    return [dimension.value_m for dimension in (room.length, room.width, room.height)]


def test_empty_room(box_room):
    room = measure_room(box_room(noise=0.0))
    # Float32 points at 4 m, averaged over thousands.
    np.testing.assert_allclose(values(room), SIZE, atol=1e-5)
    assert room.length.angle_deg < 0.01 and len(room.walls) == 6


@pytest.mark.parametrize("yaw", [0.0, 0.8, 2.3])
def test_orientation_does_not_matter(box_room, yaw):
    room = measure_room(box_room(yaw=yaw, tilt=0.09, grid=(360, 120)))
    # 1 mm of noise at 2.5 m over at least 2000 points per wall: 0.1 mm is five sigma.
    np.testing.assert_allclose(values(room), SIZE, atol=1e-4)


def test_furniture_is_not_the_wall(furnished):
    room = measure_room(furnished)
    # The shelf shows more points than its wall, the skirting and a picture stand 2 cm before
    # theirs; without them the noise alone leaves 0.02 mm, and 0.1 mm remain for their edges.
    np.testing.assert_allclose(values(room), SIZE, atol=1e-4)


def test_deterministic_and_independent_of_the_seed(furnished):
    first, again, other = (measure_room(furnished, seed=seed) for seed in (0, 0, 7))
    assert values(first) == values(again)
    np.testing.assert_allclose(values(first), values(other), atol=2e-5)


@pytest.mark.more
def test_random_sigma_is_honest(box_room):
    whitened = []
    for seed in range(12):
        room = measure_room(box_room(seed=seed, grid=(240, 80), noise=3e-3))
        for dimension, truth in zip((room.length, room.width, room.height), SIZE, strict=True):
            whitened.append((dimension.value_m - truth) / dimension.sigma_random_m)
            assert dimension.sigma_systematic_m == 0.0 and dimension.sigma_m == dimension.sigma_random_m
    # 36 values: the root mean square of as many normal ones lies within 0.77 ... 1.24 in 95 % of
    # cases; residuals cut at 2.5 sigma cost another few per cent.
    assert 0.65 < np.sqrt(np.mean(np.square(whitened))) < 1.35


def test_no_ceiling_no_height(box_room):
    room = measure_room(box_room(elevation=12.0))
    assert room.height is None
    np.testing.assert_allclose(values_of_walls(room), SIZE[:2], atol=1e-4)


def values_of_walls(room):
    return [room.length.value_m, room.width.value_m]


def test_noise_at_the_far_wall_does_not_move_it(box_room):
    room = measure_room(box_room(at=(2.4, 0.0, 1.2), noise=4e-3))
    # At 5.5 m the noise is 19 mm.
    assert abs(room.length.value_m - SIZE[0]) < 5 * room.length.sigma_m


def test_refusals(box_room):
    cloud = box_room(grid=(60, 20))
    cloud.valid = np.zeros_like(cloud.valid)
    with pytest.raises(MeasurementError, match="no valid points"):
        measure_room(cloud)
    wall = box_room()
    wall.valid = wall.valid & (np.abs(wall.angle - 0.3) < 0.3)[:, None] & (np.abs(wall.xyz[..., 2]) < 0.5)
    with pytest.raises(MeasurementError, match="No two opposite walls"):
        measure_room(wall)
    scattered = box_room(grid=(60, 20))
    scattered.xyz = np.random.default_rng(0).normal(size=scattered.xyz.shape).astype(np.float32)
    with pytest.raises(MeasurementError, match="No two opposite walls"):
        measure_room(scattered)


def test_poison_behind_the_mask(box_room):
    cloud = box_room(grid=(360, 120))
    clean = measure_room(cloud)
    holes = np.random.default_rng(1).uniform(size=cloud.valid.shape) < 0.2
    cloud.valid = ~holes
    masked = measure_room(cloud)
    cloud.xyz[holes], cloud.sigma_random[holes] = np.nan, np.nan
    assert astuple(measure_room(cloud).length)[:6] == astuple(masked.length)[:6]
    np.testing.assert_allclose(values(masked), values(clean), atol=1e-4)


@pytest.fixture(scope="module")
def scanner():
    """A rig without distortion, so that a scan of a box has a closed form."""
    camera = Pinhole(*(np.float64(x) for x in (1100.0, 1105.0, 640.0, 512.0)), np.zeros(5), width=1280, height=1024)
    laser = stack_lasers([LaserSheet.from_plane(np.array([-1.0, -0.02, 0.13]), 0.2)])
    bare = Scanner(camera, laser, Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.15]))
    sigma = {"fx": 0.3, "fy": 0.3, "cx": 0.2, "cy": 0.2, "k1": 1e-4}
    sigma |= {f"laser.laser.{name}": value for name, value in (("n1", 2e-5), ("n2", 2e-5), ("d", 2e-5), ("b2", 2e-5))}
    sigma |= {"axis.p1": 5e-5, "axis.p2": 5e-5, "axis.d1": 3e-5, "gain": 1e-6, "s1": 2e-5}
    covariance = np.diag([sigma.get(name, 0.0) ** 2 for name in bare.parameter_names()])
    return Scanner(camera, laser, bare.turntable, covariance)


@jax.jit
def poses_of(scanner, angle):
    return jax.vmap(scanner.pose)(angle)


@jax.jit
def rescan(scanner, step, q, angle):
    """Points of the same pixels at the same angles with a changed calibration."""
    moved = scanner.retract(step)
    return jax.vmap(jax.vmap(lambda q, a: moved.point(q, 0, a)[0], (0, None)))(q, angle)


@pytest.fixture(scope="module")
def scan(scanner, box_room):
    """A cloud whose points lie in the sheet at their angle, and how it looks with `step`."""
    cloud = box_room(grid=(240, 64), noise=0.0)
    exact = Scanner(scanner.camera, scanner.lasers, scanner.turntable).as_dtype(jnp.float64)
    pose = np.asarray(poses_of(exact, jnp.asarray(cloud.angle)))
    rows = np.linspace(0.0, 1023.0, 64)
    normal, distance = np.asarray(scanner.lasers.normal[0]), float(scanner.lasers.distance[0])
    # Row v is the plane 1105 y = (v - 512) z; with the sheet it meets in a line a + t b, z = t.
    slope = (rows - 512.0) / 1105.0
    b = np.stack([-(normal[1] * slope + normal[2]) / normal[0], slope, np.ones_like(rows)], -1)
    a = np.array([distance / normal[0], 0.0, 0.0])
    start = pose[:, None, :3, :3] @ a + pose[:, None, :3, 3]
    along = np.einsum("nij,lj->nli", pose[:, :3, :3], b)
    low = np.array([-3.475, -1.61, -1.2])
    leave = np.where(along > 0, (low + SIZE - start) / along, (low - start) / along).min(-1)
    p_cam = a + leave[..., None] * b
    q = np.stack([640.0 + 1100.0 * p_cam[..., 0] / p_cam[..., 2], np.broadcast_to(rows, leave.shape)], -1)
    cloud.valid = (leave > 0) & (q[..., 0] >= 0) & (q[..., 0] <= 1279)
    q = jnp.asarray(np.where(cloud.valid[..., None], q, 640.0))

    def scanned(step):
        points = np.asarray(rescan(exact, jnp.asarray(step), q, jnp.asarray(cloud.angle)))
        return type(cloud)(**{**vars(cloud), "xyz": np.where(cloud.valid[..., None], points, 0.0)})

    return scanned


@pytest.mark.more
def test_systematic_sigma_of_one_parameter_is_its_effect(scanner, scan):
    names, sigma = scanner.parameter_names(), np.sqrt(np.diag(scanner.covariance))
    nominal = measure_room(scan(np.zeros(len(names))))
    np.testing.assert_allclose(values_of_walls(nominal), SIZE[:2], atol=1e-6)
    for name in ("cx", "laser.laser.d", "axis.p1"):
        # A hundredth of a sigma: walls bend by less than their roughness, and no point changes sides.
        small = np.where(np.array(names) == name, 0.01 * sigma, 0.0)
        alone = Scanner(scanner.camera, scanner.lasers, scanner.turntable, np.diag(small**2))
        predicted = measure_room(scan(0 * small), scanner=alone)
        effect = np.subtract(values_of_walls(measure_room(scan(small))), values_of_walls(nominal))
        # The prediction looks at some of the points, and float32 keeps 0.3 um of 4 m.
        np.testing.assert_allclose(
            [predicted.length.sigma_systematic_m, predicted.width.sigma_systematic_m],
            np.abs(effect),
            rtol=0.05,
            atol=1e-6,
        )


@pytest.mark.slow
def test_systematic_sigma_is_what_wrong_calibrations_do(scanner, scan):
    sigma = np.sqrt(np.diag(scanner.covariance))
    nominal = measure_room(scan(0 * sigma), scanner=scanner)
    rng = np.random.default_rng(4)
    draws = [values_of_walls(measure_room(scan(sigma * rng.normal(size=len(sigma))))) for _ in range(100)]
    predicted = [nominal.length.sigma_systematic_m, nominal.width.sigma_systematic_m]
    # 100 draws give a standard deviation to 7 %; three of those.
    np.testing.assert_allclose(predicted, np.std(draws, axis=0), rtol=0.21)
    assert nominal.length.sigma_m > nominal.length.sigma_random_m


def test_a_cloud_of_another_rig_is_noticed(scanner, box_room):
    cloud = box_room()
    cloud.laser[:] = 1
    with pytest.raises(MeasurementError, match="points of laser 1, and the calibration has 1"):
        measure_room(cloud, scanner=scanner)


def one_row(cloud):
    """The cloud as a text without a grid gives it: nobody knows which points are of one profile."""
    valid = cloud.valid
    single = type(cloud)(**vars(cloud))
    single.xyz, single.sigma_random = cloud.xyz[valid][None], 0.0 * cloud.sigma_random[valid][None]
    single.valid, single.laser, single.angle = np.ones((1, valid.sum()), bool), np.zeros(1, np.int32), np.zeros(1)
    return single


@pytest.mark.parametrize("profiles", [8, 15])
def test_profiles_are_no_walls(profiles, box_room):
    """Each of a few profiles is a plane of its own, in which hundreds of points are."""
    sparse = box_room((3.2, 3.8, 2.4), grid=(profiles, 256), noise=2e-4, elevation=60.0)
    for cloud in (sparse, one_row(sparse)):
        try:
            room = measure_room(cloud)
        except MeasurementError as problem:
            assert "No two opposite walls" in str(problem)
        else:
            found = [one for one in (room.length, room.width, room.height) if one is not None]
            assert all(min(abs(one.value_m - each) for each in (3.2, 3.8, 2.4)) < 5e-3 for one in found), found
            assert all(one.angle_deg < 5.0 for one in found)


def test_a_dense_room_needs_no_grid(box_room):
    room = measure_room(one_row(box_room(grid=(360, 120))))
    np.testing.assert_allclose(values(room), SIZE, atol=1e-3)


def test_walls_before_which_the_room_is_not(box_room):
    """A cupboard's sides as the only planes: most of the points are behind them."""
    rng = np.random.default_rng(2)
    cloud = one_row(box_room((0.5, 0.4, 0.6), at=(0.0, 0.0, 0.3), grid=(90, 40), noise=1e-4))
    around = rng.uniform(-3.0, 3.0, (6 * cloud.xyz.shape[1], 3)).astype(np.float32)
    cloud.xyz = np.concatenate([cloud.xyz, around[None]], axis=1)
    count = cloud.xyz.shape[1]
    cloud.sigma_random, cloud.valid = np.zeros((1, count), np.float32), np.ones((1, count), bool)
    with pytest.raises(MeasurementError, match=r"No two opposite walls .* \(\d+ % of the points lie behind a plane at"):
        measure_room(cloud)
