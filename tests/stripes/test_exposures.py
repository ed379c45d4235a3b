"""Several exposures of a record become one set of stripes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes.exposures import merge_exposures


class Fields(NamedTuple):
    u: jax.Array
    sigma: jax.Array
    amplitude: jax.Array
    width: jax.Array
    chi2: jax.Array
    skew: jax.Array
    saturated: jax.Array
    valid: jax.Array


RELATIVE = (1.0, 4.0, 0.25)


def stripes(sigma, valid):
    """Three exposures; u tells which is which, and the amplitude follows the exposure."""
    sigma, valid = jnp.asarray(sigma, jnp.float32), jnp.asarray(valid)
    which = jnp.broadcast_to(jnp.arange(1.0, 4.0, dtype=jnp.float32)[:, None], sigma.shape)
    exposed = 20.0 * jnp.broadcast_to(jnp.asarray(RELATIVE, jnp.float32)[:, None], sigma.shape)
    some = lambda a: jnp.where(valid, a, jnp.zeros_like(a))
    saturated = some(which).astype(jnp.uint8)
    return Fields(*map(some, (which, sigma, exposed, 2 * which, 3 * which, 4 * which)), saturated, valid)


def test_the_valid_exposure_of_the_smallest_sigma():
    merged = merge_exposures(
        stripes(
            [[0.1, 0.1, 0.1, 0.2, 0.3], [0.2, 0.2, 0.0, 0.1, 0.2], [0.3, 0.0, 0.05, 0.3, 0.1]],
            [[True, True, True, True, False], [True, True, False, True, False], [True, False, True, True, False]],
        ),
        RELATIVE,
    )
    np.testing.assert_array_equal(merged.u, [1, 1, 3, 2, 0])
    np.testing.assert_array_equal(merged.skew, 4 * merged.u)
    np.testing.assert_array_equal(merged.saturated, merged.u)
    np.testing.assert_array_equal(merged.valid, [True, True, True, True, False])
    np.testing.assert_array_equal(merged.sigma, np.float32([0.1, 0.1, 0.05, 0.1, 0.0]))
    # All saw the same surface: as the first exposure sees it.
    np.testing.assert_allclose(merged.amplitude, [20, 20, 20, 20, 0])
    assert isinstance(merged, Fields)
    assert merged.u.dtype == jnp.float32 and merged.saturated.dtype == jnp.uint8


def test_of_equal_ones_the_longest():
    merged = merge_exposures(stripes(np.full((3, 2), 0.1), np.ones((3, 2), bool)), RELATIVE)
    np.testing.assert_array_equal(merged.u, 2)


def test_a_dictionary_stays_one_and_compiles():
    given = stripes(np.full((3, 2), 0.1), np.ones((3, 2), bool))._asdict()
    merged = jax.jit(lambda s: merge_exposures(s, RELATIVE))(given)
    assert set(merged) == set(given)
    np.testing.assert_array_equal(merged["u"], 2)


def test_one_exposure_and_further_axes_are_left_as_they_are():
    given = stripes(np.full((3, 4), 0.1), np.ones((3, 4), bool))
    grid = jax.tree.map(lambda a: a[None], given)
    merged = merge_exposures(grid, (0.3,))
    for before, after in zip(given, merged, strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("relative", [(1.0, 2.0), (1.0, 2.0, 0.0), (1.0, 2.0, -1.0), (1.0, 2.0, float("nan"))])
def test_exposures_that_do_not_fit_are_refused(relative):
    with pytest.raises(ValueError, match="relative exposures"):
        merge_exposures(stripes(np.full((3, 2), 0.1), np.ones((3, 2), bool)), relative)
