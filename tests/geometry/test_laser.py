"""The sheet: the paper's plane, rays in and beside it, and the bow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.geometry import LaserSheet, stack_lasers


SHEET = LaserSheet.from_abc(-7.606, -1.685, 1.296203)
BOWED = LaserSheet(SHEET.normal, SHEET.distance, np.array([2e-3, -1e-3]), SHEET.basis)


def test_abc_there_and_back():
    np.testing.assert_allclose(SHEET.abc(), [-7.606, -1.685, 1.296203], rtol=1e-14)
    assert SHEET.distance > 0
    np.testing.assert_allclose(np.linalg.norm(SHEET.normal), 1, atol=1e-15)


def test_sign_of_the_normal_does_not_matter():
    flipped = LaserSheet.from_plane(-3.0 * SHEET.normal, -3.0 * SHEET.distance)
    np.testing.assert_allclose(flipped.normal, SHEET.normal, atol=1e-15)
    np.testing.assert_allclose(flipped.distance, SHEET.distance, atol=1e-15)


@pytest.mark.parametrize("sheet", [SHEET, BOWED], ids=["flat", "bowed"])
def test_points_of_the_sheet_are_found_again(sheet):
    rays = np.random.default_rng(1).normal(size=(300, 3)) + [0, 0, 2]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    range_m, incidence = jax.vmap(sheet.intersect)(rays)
    hit = np.asarray(incidence) > 1e-3
    assert 50 < hit.sum() < 300
    offset = jax.vmap(sheet.offset)(range_m[:, None] * rays)
    np.testing.assert_allclose(offset[hit], 0, atol=1e-12)
    assert (np.asarray(range_m)[np.asarray(incidence) <= 0] == 0).all()


def test_bow_by_its_definition():
    p = np.array([0.4, -0.5, 2.0])
    n = SHEET.normal
    g = np.array([0.0, 0.0, 1.0]) - n[2] * n
    g /= np.linalg.norm(g)
    e = np.cross(n, g)
    rho, tau = np.hypot(g @ p, e @ p), np.arctan2(e @ p, g @ p)
    expected = n @ p - SHEET.distance - rho * (2e-3 * tau**2 - 1e-3 * tau**3)
    np.testing.assert_allclose(BOWED.offset(jnp.array(p)), expected, atol=1e-15)


def test_a_ray_in_the_sheet_is_masked_and_its_gradient_finite():
    ray = jnp.asarray(np.cross(SHEET.normal, [0.0, 1.0, 0.0]))
    ray = ray / jnp.linalg.norm(ray)
    away = -jnp.asarray(SHEET.normal)
    for v in (away, ray - 1e-30 * away):
        range_m, _ = SHEET.intersect(v)
        assert np.isfinite(range_m)
        assert np.isfinite(jax.grad(lambda r: SHEET.intersect(r)[0])(v)).all()
    assert SHEET.intersect(away)[0] == 0


def test_range_error_of_a_ray_error():
    ray = jnp.array([0.06, -0.01, 0.998])
    ray = ray / jnp.linalg.norm(ray)
    step = jnp.array([1e-6, 2e-6, 0.0])
    before, m = SHEET.intersect(ray)
    change = (SHEET.intersect(ray + step)[0] - before) / before
    # First order in a 2e-6 step: the next order is (step / m)^2, about 1e-9.
    np.testing.assert_allclose(change, -(SHEET.normal @ step) / m, atol=5e-9)


def test_retract_moves_along_the_basis():
    moved = SHEET.retract(jnp.array([1e-3, -2e-3, 0.01, 1e-4, 2e-4]))
    np.testing.assert_allclose(moved.normal @ SHEET.basis.T, [1e-3, -2e-3], atol=1e-8)
    np.testing.assert_allclose(moved.distance, SHEET.distance + 0.01)
    np.testing.assert_allclose(moved.bow, [1e-4, 2e-4])


def test_two_sheets_stacked_give_what_two_calls_give():
    stacked = stack_lasers([SHEET, BOWED])
    ray = jnp.array([0.1, 0.2, 0.97])
    for i, sheet in enumerate((SHEET, BOWED)):
        one = jax.tree.map(lambda leaf, i=i: leaf[i], stacked)
        np.testing.assert_array_equal(one.intersect(ray)[0], sheet.intersect(ray)[0])


@pytest.mark.parametrize(("normal", "distance"), [([0, 0, 0], 1.0), ([1, 0, 0], 0.0)])
def test_planes_that_are_none_are_refused(normal, distance):
    with pytest.raises(ValueError, match="plane"):
        LaserSheet.from_plane(np.array(normal, float), distance)
