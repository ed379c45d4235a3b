"""Several exposures of a record become one set of stripes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes import FrameStripes
from jaxscan.stripes.exposures import merge_exposures


RELATIVE = (1.0, 4.0, 0.25)


def stripes(sigma, valid):
    """Frames of three exposures [3 records, lines]; u says which, and amplitude and grey follow the exposure."""
    sigma, valid = np.asarray(sigma, np.float32), np.asarray(valid)
    records = len(sigma) // 3
    which = np.broadcast_to(np.tile(np.float32([1, 2, 3]), records)[:, None], sigma.shape)
    exposed = 20 * np.broadcast_to(np.tile(np.float32(RELATIVE), records)[:, None], sigma.shape)
    some = lambda a: jnp.asarray(np.where(valid, a, a.dtype.type(0)))
    numbers = map(some, (which, sigma, exposed, 2 * which, 3 * which, 4 * which, 5 * which, 2 * exposed))
    return FrameStripes(*numbers, some(which).astype(jnp.uint8), jnp.asarray(valid))


merge = jax.jit(merge_exposures, static_argnums=(2, 3))


def test_the_valid_exposure_of_the_smallest_sigma_and_of_equal_ones_the_longest():
    merged, chosen = merge(
        stripes(
            [[0.1, 0.1, 0.1, 0.2, 0.3, 0.1], [0.2, 0.2, 0.0, 0.1, 0.2, 0.1], [0.3, 0.0, 0.05, 0.3, 0.1, 0.1]],
            [
                [True] * 4 + [False, True],
                [True, True, False, True, False, True],
                [True, False, True, True, False, True],
            ],
        ),
        None,
        RELATIVE,
        1,
    )
    assert chosen is None
    np.testing.assert_array_equal(merged.u, [[1, 1, 3, 2, 0, 2]])
    np.testing.assert_array_equal(merged.skew, 4 * merged.u)
    np.testing.assert_array_equal(merged.saturated, merged.u)
    np.testing.assert_array_equal(merged.valid, [[True] * 4 + [False, True]])
    np.testing.assert_array_equal(merged.sigma, np.float32([[0.1, 0.1, 0.05, 0.1, 0.0, 0.1]]))
    # All saw the same surface: as the first exposure sees it.
    np.testing.assert_allclose(merged.amplitude, [[20, 20, 20, 20, 0, 20]])
    np.testing.assert_allclose(merged.grey, 2 * merged.amplitude)
    assert merged.u.dtype == jnp.float32 and merged.saturated.dtype == jnp.uint8


def test_the_exposure_of_the_best_chosen_candidate_gives_all_of_its_line():
    # Two records of three frames of two candidates; a candidate is good where the other is bad.
    sigma = np.full((12, 4), 0.3)
    sigma[2, 0], sigma[3, 1], sigma[11] = 0.1, 0.1, 0.1
    frames = stripes(np.repeat(np.ones((6, 4)), 2, 0), np.ones((12, 4), bool))
    frames = frames._replace(sigma=jnp.asarray(sigma, jnp.float32))
    frames = frames._replace(
        u=jnp.repeat(jnp.tile(jnp.arange(1.0, 4.0, dtype=jnp.float32), 2), 2)[:, None] + frames.u * 0
    )
    number = np.array([[0, 0, -1, -1]] * 3 + [[1, 1, 1, -1]] * 3, np.int8)
    merged, chosen = merge(frames, jnp.asarray(number), RELATIVE, 2)
    assert merged.u.shape == (4, 4)
    # Candidate 0 of the first record is best in the second frame, on line 0; elsewhere equal: the longest.
    np.testing.assert_array_equal(merged.u[0], merged.u[1])
    np.testing.assert_array_equal(merged.u[0, :2], [2, 2])
    np.testing.assert_array_equal(merged.u[2, :3], [3, 3, 3])
    np.testing.assert_array_equal(chosen, [[0, 0, -1, -1], [1, 1, 1, -1]])


@pytest.mark.parametrize("relative", [(1.0, 2.0, 0.0), (1.0, 2.0, -1.0), (1.0, 2.0, float("nan"))])
def test_exposures_that_are_not_positive_are_refused(relative):
    with pytest.raises(ValueError, match="relative exposures"):
        merge_exposures(stripes(np.full((3, 2), 0.1), np.ones((3, 2), bool)), None, relative, 1)
