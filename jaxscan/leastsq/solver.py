"""The solve: optimistix' loop and trust region, round the step of a block arrow.

The only file of the room that imports optimistix; whoever solves imports it when there is something to solve.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array
from jaxscan.leastsq.arrow import AbstractProblem, Arrow, Linear, Unknowns, arrow_times, solve_arrow


# Relative rounding error of a sum of some ten thousand squares.
_ROUNDING = 1e-13


class Minimum(NamedTuple):
    """The end of a solve."""

    y: Any
    """The unknowns."""
    residuals: Any
    """Whitened residuals there."""
    linear: Linear
    """The problem to first order there."""
    steps: Int[Array, ""]
    """Points at which residuals were evaluated, the first one included; 0 if that was not finite, and nothing holds."""
    converged: Bool[Array, ""]
    """False where it stopped after its last step."""


class PatientTrustRegion(optx.AbstractSearch):
    """optimistix' trust region, which accepts a cost that is worse by rounding alone.

    Beside the minimum the last steps change the cost by less than its last digit; judged by that
    digit every other one would be refused, thirty times in a row.
    """

    max_steps: Int[Array, ""]
    """Evaluations at most. Counted here, because optimistix' own limit is compiled in."""
    inner: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion()

    def init(self, y: Any, f_info_struct: Any) -> Any:
        return self.inner.init(y, f_info_struct), jnp.asarray(0)

    def step(self, first_step: Any, y: Any, y_eval: Any, f_info: Any, f_eval_info: Any, state: Any) -> Any:
        before, count = state[0], state[1] + 1
        size, accept, _, after = self.inner.step(first_step, y, y_eval, f_info, f_eval_info, before)
        cost, new_cost = f_info.as_min(), f_eval_info.as_min()
        same = jnp.abs(new_cost - cost) <= _ROUNDING * cost
        size = jnp.where(same, jnp.maximum(size, before.step_size), size)
        ended = optx.RESULTS.where(
            count < self.max_steps, optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached
        )
        return size, accept | same, ended, (eqx.tree_at(lambda s: s.step_size, after, size), count)


class _State(eqx.Module):
    """Between two evaluations."""

    first: Bool[Array, ""]
    step: Unknowns
    """The step from the last accepted point to the one that is evaluated next."""
    y_eval: Any
    residuals: Any
    linear: Linear
    """The problem at the last accepted point."""
    search: Any
    steps: Int[Array, ""]
    terminate: Bool[Array, ""]
    result: Any


class ArrowLM(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt of a block arrow: the step (J'J + lambda diag(J'J))^-1 J'r by Schur's complement.

    Beside optimistix' own Gauss-Newton solvers it has two properties. The function gives the normal equations with
    the residuals, so that nothing is differentiated a second time; they are formed once per point, and a step that the
    search refuses costs their elimination alone. And a point is moved by a step, not added to it: unknowns may be
    rotations and directions, whose steps are in their own frames.
    """

    rtol: Any
    atol: Any
    norm: Any
    search: Any
    damping: Float[Array, ""]
    """Damping of the first step, relative to the diagonal of J'J."""

    def init(
        self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: frozenset[object]
    ) -> _State:
        empty = lambda shapes: jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        linear: Linear = empty(aux_struct)
        step = Unknowns(linear.arrow.shared_gradient, linear.arrow.local_gradient)
        no, none = jnp.asarray(False), jnp.asarray(0)
        search = self.search.init(step, None)
        return _State(~no, step, y, empty(f_struct), linear, search, none, no, optx.RESULTS.successful)

    def step(
        self, fn: Any, y: Any, args: Any, options: Any, state: _State, tags: frozenset[object]
    ) -> tuple[Any, _State, Any]:
        residuals, linear = fn(state.y_eval, args)
        before, after = _quadratic(state.residuals, state.linear.arrow), _quadratic(residuals, linear.arrow)
        zero = jax.tree.map(jnp.zeros_like, state.step)
        size, accept, result, search = self.search.step(state.first, zero, state.step, before, after, state.search)
        change = jax.tree.map(jnp.subtract, residuals, state.residuals)
        settled = (self.norm(state.step) < self.atol) & (self.norm(change) < self.atol)
        y, residuals, linear = jax.lax.cond(
            accept, lambda: (state.y_eval, residuals, linear), lambda: (y, state.residuals, state.linear)
        )
        step = jax.tree.map(jnp.negative, Unknowns(*solve_arrow(linear.arrow, self.damping / size)))
        terminate = accept & settled & ~state.first
        there, steps, no = args.move(y, step), state.steps + 1, jnp.asarray(False)
        return y, _State(no, step, there, residuals, linear, search, steps, terminate, result), linear

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: _State, tags: frozenset[object]
    ) -> tuple[Any, Any]:
        return state.terminate, state.result

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: _State, tags: Any, result: Any
    ) -> tuple[Any, Any, dict[str, Any]]:
        return y, aux, {}


def _quadratic(residuals: Any, arrow: Arrow) -> Any:
    """The cost about a point, as optimistix' trust region asks for it."""
    gradient = Unknowns(arrow.shared_gradient, arrow.local_gradient)
    shape = jax.eval_shape(lambda: gradient)
    times = lambda step: Unknowns(*arrow_times(arrow, step.shared, step.local))
    cost = 0.5 * jnp.asarray(sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(residuals)))
    return optx.FunctionInfo.EvalGradHessian(cost, gradient, lx.FunctionLinearOperator(times, shape))


def minimise(
    problem: AbstractProblem, y: Any, damping: Float[Array, ""], tolerance: Float[Array, ""], max_steps: Int[Array, ""]
) -> Minimum:
    """Minimise half the sum of squares of a problem's residuals; to be compiled, in 64 bit.

    All arguments are arrays, so that one compiled program serves all weights, tolerances and starts.
    """
    # Changes count as they are, not relative to the size of the unknowns.
    solver = ArrowLM(0.0, tolerance, optx.rms_norm, PatientTrustRegion(max_steps), damping)
    found: Any = optx.least_squares(_linearised, solver, y, args=problem, max_steps=None, has_aux=True, throw=False)
    state = found.state
    return Minimum(found.value, state.residuals, state.linear, state.steps, state.terminate)


def _linearised(y: Any, problem: AbstractProblem) -> tuple[Any, Linear]:
    return problem.linearise(y)
