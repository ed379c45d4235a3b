"""Clouds whose points use their neighbours: measurements state the sigmas that the rows allow, not the points."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxscan.measurement import measure_distance, measure_room
from jaxscan.measurement.planes import fitted_plane
from jaxscan.measurement.samples import samples_of
from jaxscan.stripes import smooth_profiles


SIZE = 6.15, 3.82, 2.6


def smoothed(cloud, noise):
    """The cloud as a reconstruction with smoothed rows would have it: along the lines of every profile."""
    p = cloud.xyz.astype(np.float64)
    far = np.linalg.norm(p, axis=-1)
    # Disparity, as a stripe has it: a plane is straight in it, and noise of the range becomes alike everywhere.
    u, slope = 1000.0 / far, 1000.0 * noise / 6.25 / cloud.sigma_random
    sigma = cloud.sigma_random * slope
    found = smooth_profiles(u.astype(np.float32), sigma.astype(np.float32), cloud.valid)
    return SimpleNamespace(
        xyz=(p * (1000.0 / found.u / far)[..., None]).astype(np.float32),
        sigma_random=(found.sigma / slope).astype(np.float32),
        sigma_row=cloud.sigma_random,
        shared_lines=found.shared_lines,
        valid=cloud.valid,
        laser=cloud.laser,
        angle=cloud.angle,
    )


def independent(cloud):
    """The same points, with nothing said of their shared noise."""
    fields = {name: value for name, value in vars(cloud).items() if name not in ("shared_lines", "sigma_row")}
    return SimpleNamespace(**fields)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.more
def test_sigma_of_a_wall_to_wall_distance_is_that_of_the_rows(box_room):
    whitened, forgotten, stated = [], [], []
    for seed in range(60):
        # With 4 mm planes are biased by the noise itself, by its square: rows alone then err 1.27 times as stated.
        rows = box_room(seed=seed, grid=(120, 120), noise=2e-3)
        cloud = smoothed(rows, 2e-3)
        room = measure_room(cloud)
        unaware, plain = (measure_room(independent(cloud)), measure_room(rows)) if seed < 12 else (room, room)
        for name, truth in zip(("length", "width", "height"), SIZE, strict=True):
            found = getattr(room, name)
            whitened.append((found.value_m - truth) / found.sigma_random_m)
            if seed < 12:
                careless, raw = getattr(unaware, name), getattr(plain, name)
                forgotten.append((careless.value_m - truth) / careless.sigma_random_m)
                stated.append(found.sigma_random_m / raw.sigma_random_m)
    # 180 values: their root mean square is 1 within 5 %, one standard deviation.
    assert rms(whitened) == pytest.approx(1.0, abs=0.1)
    # Taken for independent, the points would promise far too much.
    assert rms(forgotten) > 1.8
    assert np.median(stated) == pytest.approx(1.0, abs=0.1)


@pytest.mark.more
def test_sigma_of_a_distance_between_patches(box_room):
    """Patches are about as large as the windows: then rows beyond the patch help too."""
    whitened = []
    for seed in range(40):
        rows = box_room(seed=seed, grid=(360, 240), noise=2e-3, yaw=0.0, tilt=0.0, at=(0.4, -0.3, 1.3))
        cloud = smoothed(rows, 2e-3)
        for z in (-0.5, -0.2, 0.1, 0.4):
            found = measure_distance(cloud, [2.675, 0.3, z], [-3.475, 0.3, z], radius_m=0.06)
            # Means of patches that lie a little beside each other.
            between = 6.15 / abs(found.b_m - found.a_m)[0] * found.value_m
            whitened.append((found.value_m - between) / found.sigma_random_m)
    # 160 values, and the correlation is a model of it.
    assert 0.85 < rms(whitened) < 1.1


def test_covariance_of_sums():
    """Two neighbours of one profile share their noise, points of different profiles do not."""
    cloud = SimpleNamespace(
        xyz=np.array([[[2.0, 0, 0], [2.0, 0, 0.001], [2.0, 0, 0.004]]] * 2),
        sigma_random=np.full((2, 3), 1e-3),
        sigma_row=np.full((2, 3), 2e-3),
        shared_lines=np.full((2, 3), 2.0),
        valid=np.array([[True, True, False], [True, False, True]]),
        laser=np.zeros(2, int),
        angle=np.zeros(2),
    )
    samples = samples_of(cloud)
    normal = np.array([1.0, 0, 0])
    covariance = samples.covariance_of(np.eye(4), normal)
    # The floor is roughness of the surface, which nobody smoothed.
    expected = 1e-6 * np.eye(4) + 1e-8 * np.eye(4)
    expected[0, 1] = expected[1, 0] = 0.5e-6
    np.testing.assert_allclose(covariance, expected, atol=1e-10)
    np.testing.assert_allclose(samples.weights_across(normal), 1 / (4e-6 + 1e-8), rtol=1e-3)
    # The order of the points does not matter.
    turned = samples.take(np.array([3, 1, 0, 2]))
    np.testing.assert_allclose(turned.covariance_of(np.eye(4), normal)[1, 2], 0.5e-6, rtol=1e-3)


def floor(by_line, noise, seed, profiles=40, lines=160):
    """A floor around a turning rig: each line sees it at one distance in all profiles."""
    rng = np.random.default_rng(seed)
    phi, far = np.linspace(0, 2 * np.pi, profiles, endpoint=False)[:, None], np.linspace(1.5, 3.0, lines)
    down, shared = np.full((profiles, lines), -1.2), np.repeat(rng.normal(size=lines // 4), 4)
    p = np.stack([far * np.cos(phi), far * np.sin(phi), down], -1)
    range_m = np.linalg.norm(p, axis=-1, keepdims=True)
    error = by_line * shared[None] + noise * rng.normal(size=down.shape)
    return SimpleNamespace(
        xyz=p * (1 + error[..., None] / range_m),
        sigma_random=np.full(down.shape, np.hypot(by_line, noise)),
        valid=np.ones(down.shape, bool),
        laser=np.zeros(profiles, int),
        angle=phi[:, 0],
    )


@pytest.mark.parametrize("by_line", [0.0, 2e-3])
def test_sigma_of_a_floor_whose_lines_err_alike_in_all_profiles(by_line):
    """Error by the place in the image is no smaller on average, as a floor has its stripe at one place."""
    z = []
    for seed in range(60):
        plane = fitted_plane(samples_of(floor(by_line, 2e-3, seed)), np.array([0.0, 0.0, 1.0]))
        z.append((abs(plane.centre[2]) - 1.2) / np.sqrt(plane.covariance[0, 0]))
    assert 0.8 < rms(z) < 1.3
