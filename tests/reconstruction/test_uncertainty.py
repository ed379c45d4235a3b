"""The interpolated systematic sigma against the exact one, and what it must vanish for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.reconstruction.points import range_table

from .conftest import small_scanner
from .exact_sigma import range_sigma


@jax.jit
def incidence_at(scanner, q, laser):
    return scanner.laser(laser).intersect(scanner.camera.unproject(q))[1]


@pytest.mark.parametrize("stripe_axis", ["rows", "columns"])
def test_table_is_the_exact_value(stripe_axis):
    scanner = small_scanner(lasers=2, covariance=True)
    table = jax.tree.map(jnp.asarray, range_table(scanner, stripe_axis))
    exact, checked = scanner.as_dtype(jnp.float64), 0
    for laser, u, v in [(0, 40.3, 11.0), (0, 20.0, 50.0), (0, 77.0, 63.0), (1, 50.9, 30.0), (1, 81.2, 3.0)]:
        q = np.array([u, v]) if stripe_axis == "rows" else np.array([np.round(u), v + 0.3])
        incidence = incidence_at(exact, jnp.asarray(q), laser)
        if incidence <= 0:
            continue
        line, across = (q[1], q[0]) if stripe_axis == "rows" else (q[0], q[1])
        sigma = table.sigma(laser, int(line), jnp.asarray(across), incidence)
        # Linear interpolation over 16 of 96 px of a strong lens; real frames are 13 times finer.
        np.testing.assert_allclose(sigma, range_sigma(scanner, q, laser), rtol=0.02)
        checked += 1
    assert checked >= 3


def test_table_on_a_real_image_size():
    scanner = small_scanner(covariance=True, width=1280, height=1024)
    table = jax.tree.map(jnp.asarray, range_table(scanner, "rows"))
    exact = scanner.as_dtype(jnp.float64)
    for u, v in [(300.3, 100.0), (613.0, 600.0), (702.7, 1001.0)]:
        incidence = incidence_at(exact, jnp.array([u, v]), 0)
        sigma = table.sigma(0, int(v), jnp.asarray(u), incidence)
        np.testing.assert_allclose(sigma, range_sigma(scanner, np.array([u, v]), 0), rtol=1e-3)


def test_monte_carlo_agrees():
    scanner = small_scanner(covariance=True)
    q = np.array([45.0, 20.0])
    rng = np.random.default_rng(0)
    steps = rng.multivariate_normal(np.zeros(len(scanner.covariance)), scanner.covariance, 4000, method="eigh")
    exact = type(scanner)(scanner.camera, scanner.lasers, scanner.turntable, laser_names=scanner.laser_names)
    exact = exact.as_dtype(jnp.float64)

    @jax.jit
    @jax.vmap
    def ranges(step):
        moved = exact.retract(step)
        return moved.laser(0).intersect(moved.camera.unproject(jnp.asarray(q)))[0]

    # 4000 draws give a standard deviation to 1.1 %; four of those.
    np.testing.assert_allclose(np.std(ranges(jnp.asarray(steps))), range_sigma(scanner, q, 0), rtol=0.045)


def test_without_covariance_it_is_zero():
    table = jax.tree.map(jnp.asarray, range_table(small_scanner()))
    assert float(table.sigma(0, 5, jnp.asarray(40.0), jnp.asarray(0.2))) == 0.0
