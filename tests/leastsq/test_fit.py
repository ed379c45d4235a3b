"""A fit of any residuals against dense solvers, its covariance, its losses, and what it compiles."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from jax.flatten_util import ravel_pytree

from jaxscan.errors import CalibrationError
from jaxscan.leastsq import Arrow, Cauchy, Group, Huber, Prior, covariance_of, fit, reduce_arrow, solve_arrow
from jaxscan.leastsq.arrow import arrow_times


def ray(shared, own, data):
    """A bent ray through a point of its own: nonlinear in both."""
    return shared["bend"] * jnp.sin(data["t"] + own[0]) + own[1] * data["t"] + shared["more"][0] - data["y"]


def gauge(shared, own, data):
    """Meets no block."""
    return shared["more"][1] * shared["bend"] - data


@pytest.fixture(scope="module")
def groups():
    random = np.random.default_rng(3)
    block, t = np.repeat(np.arange(5), 8), np.tile(np.linspace(0, 3, 8), 5)
    own = np.column_stack([np.linspace(-0.5, 0.5, 5), np.linspace(1, 2, 5)])[block]
    sigma = np.where(t < 1, 0.01, 0.02)
    y = 2.0 * np.sin(t + own[:, 0]) + own[:, 1] * t + 0.3 + sigma * random.normal(size=t.shape)
    return [Group(ray, {"t": t, "y": y}, sigma, block), Group(gauge, np.array([3.0, 3.02]), 0.01)]


START = {"bend": np.array(1.5), "more": np.array([0.1, 1.0])}
BLOCKS = np.column_stack([np.zeros(5), np.ones(5)])


def dense(groups):
    """All whitened residuals of one vector of all unknowns."""
    flat, shaped = ravel_pytree((jax.tree.map(jnp.asarray, START), jnp.asarray(BLOCKS)))
    rays, gauges = groups

    def vector(numbers, _=None):
        shared, blocks = shaped(numbers)
        first = jax.vmap(partial(ray, shared))(blocks[rays.block], rays.data) / rays.sigma
        return jnp.concatenate([first, gauge(shared, None, gauges.data) / gauges.sigma])

    return vector, flat


def test_the_minimum_and_its_covariance_are_those_of_a_dense_solver(groups):
    found = fit(START, groups, blocks=BLOCKS)
    vector, flat = dense(groups)
    solver = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12)
    theirs = np.asarray(optx.least_squares(vector, solver, flat, max_steps=200).value)
    ours = np.concatenate([np.asarray(ravel_pytree(found.shared)[0]), found.blocks.ravel()])
    assert found.converged
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    jacobian = np.asarray(jax.jit(jax.jacfwd(vector))(theirs))
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(found.covariance.shared, inverse[:3, :3], rtol=1e-6)
    leverage = np.einsum("ri,ij,rj->r", jacobian, inverse, jacobian)
    np.testing.assert_allclose(np.concatenate([part.ravel() for part in found.leverages]), leverage, atol=1e-6)
    # As many unknowns as the fit takes up.
    assert sum(part.sum() for part in found.leverages) == pytest.approx(13.0)
    assert found.noise[0] == pytest.approx(1.0, abs=0.3)


def test_another_sigma_and_other_data_compile_nothing(groups):
    fit(START, groups, blocks=BLOCKS)
    compiled = []
    listen = lambda event, *_, **__: compiled.append(event) if event.endswith("backend_compile_duration") else None
    jax.monitoring.register_event_duration_secs_listener(listen)
    changed = [Group(ray, groups[0].data, 2 * groups[0].sigma, groups[0].block), groups[1]]
    fit(START, changed, blocks=1.1 * BLOCKS, tolerance=1e-6, max_steps=50)
    assert compiled == []


def test_a_prior_alone_is_its_own_fit():
    information = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    mean = {"bend": np.array(1.0), "more": np.array([2.0, 3.0])}
    none = Group(gauge, np.zeros(1), 1e6)
    found = fit(START, [none], prior=Prior(mean, information))
    np.testing.assert_allclose(ravel_pytree(found.shared)[0], [1.0, 2.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(found.covariance.shared, np.linalg.inv(information), atol=1e-9)


def test_what_nothing_determines_is_told_in_one_line(groups):
    # Bend and the second number only as a product.
    found = fit(START, [Group(gauge, np.array([3.0]), 0.01)])
    with pytest.raises(
        CalibrationError, match=r"^The residuals leave .* undetermined: add observations, or a prior\.$"
    ):
        _ = found.covariance
    with pytest.raises(CalibrationError, match="not finite where the fit begins"):
        fit({**START, "bend": np.array(np.nan)}, groups, blocks=BLOCKS)


def test_few_steps_are_not_called_a_minimum(groups):
    found = fit(START, groups, blocks=BLOCKS, max_steps=2)
    assert not found.converged and found.steps == 2


@pytest.mark.parametrize("loss", [Huber(), Cauchy()])
def test_root_and_weights_are_of_one_loss(loss):
    values = jnp.asarray([-9.0, -1.5, -1e-5, 0.0, 0.3, 1.3, 1.4, 30.0])
    root, slope = jax.jit(jax.vmap(jax.value_and_grad(lambda r: loss.root(r))))(values)
    # The derivative of half the squared root is the weight times the residual.
    np.testing.assert_allclose(root * slope, np.asarray(values) * loss.weights(np.abs(values)) ** 2, atol=1e-9)
    assert np.isfinite(slope).all()


def test_a_loss_keeps_an_outlier_from_pulling(groups):
    spoiled = np.array(groups[0].data["y"])
    spoiled[3] += 1.0
    wrong = {**groups[0].data, "y": spoiled}
    plain, robust = (
        fit(START, [Group(ray, wrong, groups[0].sigma, groups[0].block, loss), groups[1]], blocks=BLOCKS, max_steps=500)
        for loss in (None, Huber())
    )
    clean = float(fit(START, groups, blocks=BLOCKS).shared["bend"])
    assert robust.converged
    assert abs(float(robust.shared["bend"]) - clean) < 0.1 * abs(float(plain.shared["bend"]) - clean)


@pytest.fixture(scope="module")
def arrow():
    """Of random derivatives; the last shared unknown and the last block meet nothing."""
    random = np.random.default_rng(1)
    rows = random.normal(size=(4, 30, 7))
    rows[:, :, 4], rows[3] = 0.0, 0.0
    square, gradient = np.swapaxes(rows, 1, 2) @ rows, rows.sum(1)
    return Arrow(
        square[:, :5, :5].sum(0), square[:, :5, 5:], square[:, 5:, 5:], gradient[:, :5].sum(0), gradient[:, 5:]
    )


def whole(arrow):
    """The same as one matrix."""
    count, (blocks, own) = len(arrow.shared), arrow.local_gradient.shape
    matrix = np.zeros((count + blocks * own,) * 2)
    matrix[:count, :count] = arrow.shared
    for block in range(blocks):
        there = slice(count + own * block, count + own * (block + 1))
        matrix[there, there], matrix[:count, there] = arrow.local[block], arrow.cross[block]
        matrix[there, :count] = arrow.cross[block].T
    return matrix


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_step_solves_the_damped_equations_and_moves_nothing_that_is_not_met(arrow, damping):
    matrix = whole(arrow)
    empty = np.diag(matrix) == 0
    damped = matrix + np.diag(np.where(empty, 1.0, damping * np.diag(matrix)))
    expected = np.linalg.solve(damped, np.concatenate([arrow.shared_gradient, arrow.local_gradient.ravel()]))
    in_jax = jax.jit(solve_arrow)(jax.tree.map(jnp.asarray, arrow), damping)
    for shared, local in (solve_arrow(arrow, damping), in_jax):
        np.testing.assert_allclose(np.concatenate([shared, np.ravel(local)]), expected, atol=1e-10)
    assert not expected[empty].any()


def test_the_inverse_by_blocks_is_the_inverse(arrow):
    matrix = whole(arrow)
    inverse = np.linalg.inv(matrix + np.diag((np.diag(matrix) == 0).astype(float)))
    known = covariance_of(arrow)
    for block in range(4):
        met = np.concatenate([np.arange(5), 5 + 2 * block + np.arange(2)])
        np.testing.assert_allclose(known.of(np.array([block]))[0], inverse[np.ix_(met, met)], atol=1e-10)
    np.testing.assert_allclose(np.linalg.inv(reduce_arrow(arrow).information), known.shared, atol=1e-10)
    step = np.concatenate([np.ravel(part) for part in known.step(arrow)])
    np.testing.assert_allclose(
        matrix @ step, np.concatenate([np.ravel(part) for part in arrow_times(arrow, step[:5], step[5:].reshape(4, 2))])
    )
    np.testing.assert_allclose(step, np.concatenate([np.ravel(part) for part in solve_arrow(arrow)]), atol=1e-10)
