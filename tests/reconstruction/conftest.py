"""A small rig and closed-form stripes, shared by the tests of this folder."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.stripes import Stripes


WIDTH, HEIGHT = 96, 64
DISTORTION = np.array([-0.25, 0.08, 1e-3, -5e-4, 0.0])


def small_scanner(*, lasers: int = 1, covariance: bool = False, width: int = WIDTH, height: int = HEIGHT) -> Scanner:
    """A camera of about 50 degrees, sheets crossing the axis of view beyond 1 m, an axis behind it."""
    focal = 1.05 * width
    camera = Pinhole(
        *(np.float64(x) for x in (focal, 1.01 * focal, 0.49 * width, 0.52 * height)),
        DISTORTION,
        width=width,
        height=height,
    )
    sheets = [
        LaserSheet.from_plane(np.array([-1.0, -0.03, 0.30]), 0.20),
        LaserSheet.from_plane(np.array([1.0, 0.05, 0.35]), 0.22),
    ]
    turntable = Turntable.from_axis([0.02, -1.0, 0.01], [0.01, 0.0, -0.15])
    names = ("left", "right")[:lasers]
    scanner = Scanner(camera, stack_lasers(sheets[:lasers]), turntable, laser_names=names)
    if not covariance:
        return scanner
    count = len(scanner.parameter_names())
    root = np.random.default_rng(1).normal(size=(count, count)) * 1e-4
    scale = np.array([1000.0] * 4 + [1.0] * (count - 4))
    return Scanner(
        camera, scanner.lasers, turntable, (root @ root.T) * np.outer(scale, scale) / count, laser_names=names
    )


def flat_stripes(shape: tuple[int, int], u: float | np.ndarray, sigma: float = 0.05) -> Stripes:
    """Stripes at the given centres in every line."""
    full = np.full(shape, 1.0, np.float32)
    return Stripes(
        u=(full * u).astype(np.float32),
        sigma=sigma * full,
        amplitude=80.0 * full,
        width=2.0 * full,
        chi2=full,
        skew=0.0 * full,
        saturated=np.zeros(shape, np.uint8),
        valid=np.ones(shape, bool),
        record=np.arange(shape[0]),
        laser=np.zeros(shape[0], int),
    )


STEPS = 24
"""Angles for which stripes are computed at a time: one compiled function for sweeps of any length."""


def stripes_on_plane(
    scanner: Scanner, phi: np.ndarray, normal: np.ndarray, distance: float, laser: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Where the stripe on the plane normal . p = distance (scanner frame) is seen, per row.

    Solved for u in float64 by bisection along every row; returns centres and where they exist.
    """
    with jax.enable_x64(True):
        sheet = jax.tree.map(lambda field: field[laser : laser + 1], scanner.lasers)
        exact = Scanner(scanner.camera, sheet, scanner.turntable).as_dtype(jnp.float64)
        padded = np.resize(phi, -(-len(phi) // STEPS) * STEPS).reshape(-1, STEPS)
        found = [_on_plane(exact, some, jnp.asarray(normal), jnp.asarray(distance)) for some in padded]
        return tuple(np.concatenate([np.asarray(one[k]) for one in found])[: len(phi)] for k in (0, 1))


@jax.jit
def _on_plane(exact, phi, normal, distance):
    lines = jnp.arange(exact.camera.height, dtype=jnp.float64)

    def offset(u, line, phi):
        point, incidence = exact.point(jnp.stack([u, line]), 0, phi)
        return jnp.where(incidence > 0, jnp.dot(normal, point) - distance, jnp.inf)

    def solve(line, phi):
        grid = jnp.linspace(0.0, exact.camera.width - 1.0, 4 * exact.camera.width)
        values = jax.vmap(offset, (0, None, None))(grid, line, phi)
        cross = jnp.isfinite(values[1:]) & jnp.isfinite(values[:-1]) & (values[1:] * values[:-1] <= 0)
        first = jnp.argmax(cross)
        low, high = grid[first], grid[first + 1]

        def halve(_, bounds):
            low, high = bounds
            middle = 0.5 * (low + high)
            left = offset(low, line, phi) * offset(middle, line, phi) <= 0
            return jnp.where(left, low, middle), jnp.where(left, middle, high)

        low, high = jax.lax.fori_loop(0, 45, halve, (low, high))
        return 0.5 * (low + high), jnp.any(cross)

    return jax.vmap(jax.vmap(solve, (0, None)), (None, 0))(lines, phi)
