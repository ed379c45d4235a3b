"""A sweep seen by a fisheye, by a forward model in plain NumPy: points beside and behind the camera too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.geometry import Fisheye, LaserSheet, Scanner, Turntable, stack_lasers
from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.reconstruction.points import range_table

from .conftest import flat_stripes
from .exact_sigma import range_sigma


WIDTH, HEIGHT, RADIUS = 96, 64, 2.0
FOCAL, CENTRE, LENS = (18.0, 18.2), (47.2, 31.9), (-0.02, 0.004, -0.001, 1e-4)
NORMAL, DISTANCE = np.array([1.0, 0.05, 0.35]) / np.linalg.norm([1.0, 0.05, 0.35]), 0.22
AXIS, POINT = np.array([0.02, -1.0, 0.01]) / np.linalg.norm([0.02, -1.0, 0.01]), np.array([0.01, 0.0, -0.15])


def pixels(p):
    radius = np.hypot(p[..., 0], p[..., 1])
    theta = np.arctan2(radius, p[..., 2])
    k1, k2, k3, k4 = LENS
    theta_d = theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9
    return np.array(CENTRE) + np.array(FOCAL) * (theta_d / radius)[..., None] * p[..., :2]


def stripe_on_a_sphere(centre):
    """Where the sheet meets a sphere about `centre` (camera frame), at every row it reaches: u, points, seen."""
    ahead = np.array([0.0, 0.0, 1.0]) - NORMAL[2] * NORMAL
    ahead = ahead / np.linalg.norm(ahead)
    across = np.cross(NORMAL, ahead)
    offset = NORMAL @ centre - DISTANCE
    middle, size = centre - offset * NORMAL, np.sqrt(RADIUS**2 - offset**2)
    point = lambda tau: middle + size * (np.cos(tau)[:, None] * ahead + np.sin(tau)[:, None] * across)
    # The row grows with tau from 100 degrees on one side to 100 degrees on the other.
    low, high = np.full(HEIGHT, np.radians(-100)), np.full(HEIGHT, np.radians(100))
    grows = np.sign(pixels(point(high))[0, 1] - pixels(point(low))[0, 1])
    rows = np.arange(HEIGHT)
    ends = np.sort([pixels(point(end[:1]))[0, 1] for end in (low, high)])
    for _ in range(60):
        half = 0.5 * (low + high)
        below = grows * (pixels(point(half))[:, 1] - rows) < 0
        low, high = np.where(below, half, low), np.where(below, high, half)
    p = point(0.5 * (low + high))
    u = pixels(p)[:, 0]
    return u, p, (rows > ends[0]) & (rows < ends[1]) & (u > 0) & (u < WIDTH - 1)


def rotation_about_the_axis(angle):
    x, y, z = AXIS
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@pytest.fixture(scope="module")
def scanner():
    camera = Fisheye(*map(np.float64, (*FOCAL, *CENTRE)), np.array(LENS), WIDTH, HEIGHT)
    sheets, table = stack_lasers([LaserSheet.from_plane(NORMAL, DISTANCE)]), Turntable.from_axis(AXIS, POINT)
    bare = Scanner(camera, sheets, table)
    count = len(bare.parameter_names())
    root = np.random.default_rng(1).normal(size=(count, count)) * 1e-4
    scale = np.array([100.0] * 4 + [1.0] * (count - 4))
    return Scanner(camera, sheets, table, (root @ root.T) * np.outer(scale, scale) / count)


def test_points_all_around_are_found(scanner):
    foot = POINT - (POINT @ AXIS) * AXIS
    phi = np.radians(np.arange(14) * 20.0)
    forward = np.array([0.0, 0.0, 1.0]) - AXIS[2] * AXIS
    forward = forward / np.linalg.norm(forward)
    scanner_from_camera = np.stack([forward, np.cross(AXIS, forward), AXIS])
    u, seen, room = np.zeros((14, HEIGHT)), np.zeros((14, HEIGHT), bool), np.zeros((14, HEIGHT, 3))
    behind = np.zeros((14, HEIGHT), bool)
    ball = np.array([0.3, -0.2, 0.1])
    for i, angle in enumerate(phi):
        turn = rotation_about_the_axis(angle)
        # p_room = R (turn (p - foot) + foot - foot): the ball stands still in the room.
        centre = turn.T @ (scanner_from_camera.T @ ball) + foot
        u[i], p, seen[i] = stripe_on_a_sphere(centre)
        room[i] = (turn @ (p - foot).T).T @ scanner_from_camera.T
        behind[i] = p[:, 2] < 0
    stripes = flat_stripes(u.shape, np.where(seen, u, 0.0))
    stripes = type(stripes)(**{**vars(stripes), "valid": seen})
    frames = np.zeros((14, HEIGHT, WIDTH), np.uint8)
    cloud = reconstruct(
        Sweep(frames, frames, phi),
        scanner,
        stripes=stripes,
        settings=ReconstructSettings(chunk_records=7, smooth="off"),
    )
    np.testing.assert_array_equal(cloud.valid, seen)
    assert seen.mean() > 0.9 and (behind & seen).sum() > 40
    # float32: 4e-6 px of the stripe's place at up to 1.5 m/px.
    np.testing.assert_allclose(cloud.xyz[seen], room[seen], atol=2e-5)
    np.testing.assert_allclose(np.linalg.norm(cloud.xyz[seen] - ball, axis=-1), RADIUS, atol=2e-5)
    assert np.isfinite(cloud.sigma_systematic).all() and (cloud.sigma_systematic[seen] > 0).all()
    # Normals point into the ball from behind the camera as well.
    kept = (cloud.normals != 0).any(-1)
    towards = (ball - cloud.xyz[kept]) / RADIUS
    assert kept.sum() > 0.8 * seen.sum() and np.median((cloud.normals[kept] * towards).sum(-1)) > 0.99


@pytest.mark.slow
def test_systematic_sigma_beside_and_behind_the_camera(scanner):
    # The same lens with 13 times the pixels.
    fine, focal, centre = 13.0, np.array(FOCAL), np.array(CENTRE)
    camera = Fisheye(*(fine * focal), *(fine * centre), np.array(LENS), int(fine * WIDTH), int(fine * HEIGHT))
    large = Scanner(camera, scanner.lasers, scanner.turntable, scanner.covariance)
    table = jax.tree.map(jnp.asarray, range_table(large, "rows"))
    assert np.isfinite(table.numerator).all()
    tau = np.radians([-93.0, -60.0, 5.0, 75.0, 95.0])
    ahead = np.array([0.0, 0.0, 1.0]) - NORMAL[2] * NORMAL
    ahead = ahead / np.linalg.norm(ahead)
    p = DISTANCE * NORMAL + 2.0 * np.outer(np.cos(tau), ahead) + 2.0 * np.outer(np.sin(tau), np.cross(NORMAL, ahead))
    assert p[0, 2] < 0 and p[-1, 2] < 0
    for u, v in fine * pixels(p):
        incidence = large.laser(0).intersect(camera.unproject(jnp.array([u, np.round(v)])))[1]
        sigma = table.sigma(0, int(np.round(v)), jnp.asarray(u), incidence)
        # Linear interpolation over 16 px, which are 4 degrees here, of what grows with the ninth power of the angle.
        np.testing.assert_allclose(sigma, range_sigma(large, np.array([u, np.round(v)]), 0), rtol=0.03)
