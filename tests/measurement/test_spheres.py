"""Spheres: exact without noise, no bias and honest sigmas with it."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxscan.errors import MeasurementError
from jaxscan.measurement import measure_sphere


CENTRE, RADIUS = np.array([2.0, 0.5, 0.2]), 0.1


def cap(*, noise, seed=0, spacing=4e-3, share=0.3):
    """The part of a sphere, a share of its surface, that faces the origin, on a grid of rays; noise along the rays."""
    ahead = CENTRE / np.linalg.norm(CENTRE)
    beside = np.cross(ahead, [0.0, 0.0, 1.0])
    beside /= np.linalg.norm(beside)
    steps = np.arange(-15, 16) * spacing
    a, b = np.meshgrid(steps, steps, indexing="ij")
    rays = ahead + a[..., None] * beside + b[..., None] * np.cross(ahead, beside)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    nearest = rays @ CENTRE
    square = nearest**2 - CENTRE @ CENTRE + RADIUS**2
    far = nearest - np.sqrt(np.maximum(square, 0.0))
    facing = -((rays * far[..., None] - CENTRE) / RADIUS) @ ahead
    valid = (square > 0) & (facing > 1.0 - 2.0 * share)
    far = far + noise * np.random.default_rng(seed).normal(size=far.shape)
    return SimpleNamespace(
        xyz=np.where(valid[..., None], rays * far[..., None], 0.0),
        sigma_random=np.full(far.shape, max(noise, 1e-6)),
        valid=valid,
        laser=np.zeros(len(steps), np.int32),
        angle=steps,
    )


def test_without_noise_it_is_exact():
    found = measure_sphere(cap(noise=0.0), CENTRE + [0.01, -0.02, 0.01], radius_m=0.095)
    np.testing.assert_allclose(found.centre_m, CENTRE, atol=1e-7)
    assert found.radius_m == pytest.approx(RADIUS, abs=1e-7) and found.rms_m < 1e-7


@pytest.mark.more
@pytest.mark.parametrize("noise", [3e-4, 3e-3])
@pytest.mark.parametrize("held", [False, True])
def test_sigmas_are_honest_and_there_is_no_bias(noise, held):
    """With 3 mm the curvature of the sphere is felt: points taken radially would make it smaller by a sigma."""
    whitened = []
    for seed in range(60):
        found = measure_sphere(
            cap(noise=noise, seed=seed), CENTRE + [0.01, -0.02, 0.01], radius_m=RADIUS if held else 0.103, held=held
        )
        if held:
            assert found.radius_m == RADIUS and found.radius_sigma_m == 0.0
        errors = (found.centre_m - CENTRE) / found.centre_sigma_m
        whitened.append(errors if held else [*errors, (found.radius_m - RADIUS) / found.radius_sigma_m])
    whitened = np.array(whitened)
    # Of 60 draws the mean of a coordinate has a standard deviation of 0.13 and its spread one of 0.09: three of each
    # beside a bias of 0 and a spread of 1.
    assert (np.abs(whitened.mean(0)) < 0.39).all()
    assert (np.abs(whitened.std(0) - 1.0) < 0.27).all()
    # Together: mean square of all coordinates.
    assert 0.8 < np.sqrt(np.mean(whitened**2)) < 1.2


@pytest.mark.slow
def test_bias_is_below_a_fifth_of_a_sigma():
    whitened = np.array(
        [
            (found.radius_m - RADIUS) / found.radius_sigma_m
            for found in (measure_sphere(cap(noise=3e-3, seed=seed), CENTRE, radius_m=RADIUS) for seed in range(400))
        ]
    )
    # 400 draws: the mean has a standard deviation of 0.05.
    assert abs(whitened.mean()) < 0.2 and abs(whitened.std() - 1.0) < 0.2


def test_points_beside_the_sphere_do_not_count():
    cloud = cap(noise=3e-4)
    profile, line = np.nonzero(cloud.valid)
    chosen = np.random.default_rng(1).choice(len(profile), len(profile) // 8, replace=False)
    cloud.xyz[profile[chosen], line[chosen]] *= 1.03
    found = measure_sphere(cloud, CENTRE, radius_m=RADIUS)
    assert abs(found.radius_m - RADIUS) < 5 * found.radius_sigma_m
    assert (np.abs(found.centre_m - CENTRE) < 5 * found.centre_sigma_m).all()


def test_refusals():
    cloud = cap(noise=3e-4)
    with pytest.raises(MeasurementError, match="Only 0 points"):
        measure_sphere(cloud, CENTRE + [1.0, 0.0, 0.0], radius_m=RADIUS)
    flat = cap(noise=3e-4)
    ahead = CENTRE / np.linalg.norm(CENTRE)
    along = flat.xyz @ ahead
    flat.xyz *= np.where(flat.valid, 1.95 / np.where(along > 0, along, 1.0), 0.0)[..., None]
    with pytest.raises(MeasurementError, match="No sphere"):
        measure_sphere(flat, 2.05 * ahead, radius_m=RADIUS)
    with pytest.raises(MeasurementError, match="No sphere"):
        measure_sphere(cloud, CENTRE, radius_m=1.0)
    cloud.valid[:] = False
    with pytest.raises(MeasurementError, match="no valid points"):
        measure_sphere(cloud, CENTRE, radius_m=RADIUS)
