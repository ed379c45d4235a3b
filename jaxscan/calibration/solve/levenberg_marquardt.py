"""Levenberg-Marquardt whose step uses that the problem is a block arrow.

The shared unknowns meet every residual, a board's pose only those of its own placement. So (1)
the columns of all poses are found together: K + 6 directional derivatives in place of
K + 6 * placements; (2) the blocks of J'J are formed once per linearisation and a rejected step
costs one small factorisation; (3) everything else is optimistix.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.solve.problem import Problem, Step, move, zero_step
from jaxscan.calibration.solve.residuals import Residuals, residuals
from jaxscan.geometry import Array


# Relative rounding error of a sum of some ten thousand squares.
_ROUNDING = 1e-13


class Blocks(NamedTuple):
    """J'J and J'r of the block arrow."""

    shared: Float[Array, "shared shared"]
    cross: Float[Array, "placements shared 6"]
    local: Float[Array, "placements 6 6"]
    shared_gradient: Float[Array, " shared"]
    local_gradient: Float[Array, "placements 6"]


class Columns(NamedTuple):
    """Derivatives of the residuals of one kind, leading with the unknowns."""

    shared: Float[Array, "shared owners rows"]
    local: Float[Array, "6 owners rows"]


class Jacobian(NamedTuple):
    """Derivatives of all residuals."""

    corner: Columns
    stripe: Columns
    prior: Float[Array, "shared priors"]


class BlockArrowDescent(optx.AbstractDescent):
    """Damped step (J'J + lambda diag(J'J))^-1 J'r by Schur's complement."""

    view_owner: Int[Array, " views"]
    """Placement that each row of corner residuals belongs to."""
    stripe_owner: Int[Array, " stripes"]
    """Placement that each row of stripe residuals belongs to."""
    damping: Float[Array, ""]
    """Damping of the first step, relative to the diagonal of J'J. optimistix' own start, 1, costs
    ten steps more from any seed worth its name."""

    def init(self, y: Step, f_info_struct: Any) -> Blocks:
        count, shared = y.local.shape[0], y.shared.shape[0]
        zeros = lambda *shape: jnp.zeros(shape, y.shared.dtype)
        return Blocks(
            zeros(shared, shared), zeros(count, shared, 6), zeros(count, 6, 6), zeros(shared), zeros(count, 6)
        )

    def query(self, y: Step, f_info: Any, state: Blocks) -> Blocks:
        jacobian = jacobian_columns(f_info.jac.mv, y)
        return form_blocks(jacobian, f_info.residual, self.view_owner, self.stripe_owner, len(y.local))

    def step(self, step_size: Any, state: Blocks) -> tuple[Step, Any]:
        shared, local = schur_step(state, self.damping / step_size)
        return Step(-shared, -local), optx.RESULTS.successful


class PatientTrustRegion(optx.AbstractSearch):
    """optimistix' trust region, which takes a cost that changed by rounding alone for no worse.

    Beside the minimum the last steps change the cost by less than its last digit; judged by that
    digit every other one would be refused, thirty times in a row.
    """

    inner: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion()

    def init(self, y: Any, f_info_struct: Any) -> Any:
        return self.inner.init(y, f_info_struct)

    def step(self, first_step: Any, y: Any, y_eval: Any, f_info: Any, f_eval_info: Any, state: Any) -> Any:
        size, accept, result, new_state = self.inner.step(first_step, y, y_eval, f_info, f_eval_info, state)
        cost, new_cost = f_info.as_min(), f_eval_info.as_min()
        same = jnp.abs(new_cost - cost) <= _ROUNDING * cost
        size = jnp.where(same, jnp.maximum(size, state.step_size), size)
        return size, accept | same, result, eqx.tree_at(lambda s: s.step_size, new_state, size)


class BlockArrowLM(optx.AbstractGaussNewton):
    """optimistix' Gauss-Newton loop and trust region round `BlockArrowDescent`."""

    rtol: Any
    atol: Any
    descent: Any  # type: ignore[misc]
    norm: Any = optx.rms_norm
    search: Any = PatientTrustRegion()
    verbose: Any = eqx.field(default=lambda **_: None, static=True)


class Solution(NamedTuple):
    """The end of a solve."""

    problem: Problem
    """The problem seen from the minimum."""
    step: Step
    """The step to there, from the problem that was given."""
    steps: Int[Array, ""]
    converged: Bool[Array, ""]
    """False where it stopped after its last step."""


def solve(problem: Problem, damping: Float[Array, ""], tolerance: Float[Array, ""], max_steps: int) -> Solution:
    """Minimise the sum of squares of `residuals`; traceable, in 64 bit.

    Args:
        problem: With its weights.
        damping: Of the first step, relative to the diagonal of J'J [1].
        tolerance: Root mean square change of scaled unknowns and of whitened residuals at which
            to stop [1].
        max_steps: Steps at most.
    """
    start = zero_step(problem)
    descent = BlockArrowDescent(problem.placement, problem.stripe_placement(), damping)
    solution: Any = optx.least_squares(
        residuals,
        BlockArrowLM(descent=descent, rtol=tolerance, atol=tolerance),
        start,
        args=problem,
        max_steps=max_steps,
        throw=False,
    )
    return Solution(
        move(solution.value, problem),
        solution.value,
        solution.stats["num_steps"],
        jnp.asarray(solution.result == optx.RESULTS.successful),
    )


def jacobian_columns(product: Callable[[Step], Residuals], y: Step) -> Jacobian:
    """Columns of the Jacobian by coloured forward mode.

    Args:
        product: Jacobian times a step.
        y: Any step, for its shapes.
    """
    count = y.shared.shape[0]
    # Behind the barrier, or the compiler works out products with these constants itself, slowly.
    unit = jax.lax.optimization_barrier(jnp.eye(count + 6, dtype=y.shared.dtype))
    # Poses of different placements meet different residuals, so all are moved at once.
    columns = jax.vmap(lambda e: product(Step(e[:count], jnp.broadcast_to(e[None, count:], y.local.shape))))(unit)
    split = lambda array: Columns(*jnp.split(array, [count]))
    return Jacobian(split(columns.corner), split(columns.stripe), columns.prior[:count])


def form_blocks(
    jacobian: Jacobian,
    residual: Residuals,
    view_owner: Int[Array, " views"],
    stripe_owner: Int[Array, " stripes"],
    placements: int,
) -> Blocks:
    """J'J and J'r from the columns, summed over the rows of each placement."""
    shared = jacobian.prior @ jacobian.prior.T
    shared_gradient = jacobian.prior @ residual.prior
    cross = jnp.zeros((placements, shared.shape[0], 6), shared.dtype)
    local = jnp.zeros((placements, 6, 6), shared.dtype)
    local_gradient = jnp.zeros((placements, 6), shared.dtype)
    for columns, values, owner in (
        (jacobian.corner, residual.corner, view_owner),
        (jacobian.stripe, residual.stripe, stripe_owner),
    ):
        flat = columns.shared.reshape(shared.shape[0], -1)
        shared = shared + flat @ flat.T
        shared_gradient = shared_gradient + flat @ values.ravel()
        cross = cross.at[owner].add(jnp.einsum("kvm,dvm->vkd", columns.shared, columns.local))
        local = local.at[owner].add(jnp.einsum("dvm,evm->vde", columns.local, columns.local))
        local_gradient = local_gradient.at[owner].add(jnp.einsum("dvm,vm->vd", columns.local, values))
    return Blocks(shared, cross, local, shared_gradient, local_gradient)


def schur_step(
    blocks: Blocks, damping: Float[Array, ""]
) -> tuple[Float[Array, " shared"], Float[Array, "placements 6"]]:
    """Solve (J'J + damping diag(J'J)) step = J'r."""
    reduced, coupling, rhs, local = reduce_blocks(blocks, damping)
    factor = jnp.linalg.cholesky(reduced)
    shared = jax.scipy.linalg.cho_solve((factor, True), rhs)
    return shared, local - jnp.einsum("vdk,k->vd", coupling, shared)


def reduce_blocks(
    blocks: Blocks, damping: Float[Array, ""]
) -> tuple[
    Float[Array, "shared shared"],
    Float[Array, "placements 6 shared"],
    Float[Array, " shared"],
    Float[Array, "placements 6"],
]:
    """Eliminate the poses.

    Returns:
        reduced: Information of the shared unknowns, S = U - sum W V^-1 W'.
        coupling: V^-1 W' of every placement.
        rhs: Right hand side that belongs to S.
        local: V^-1 b of every placement.
    """
    factors = jax.vmap(lambda v: jnp.linalg.cholesky(v + jnp.diag(_damped(jnp.diag(v), damping))))(blocks.local)
    solve_local = jax.vmap(lambda factor, b: jax.scipy.linalg.cho_solve((factor, True), b))
    coupling = solve_local(factors, jnp.swapaxes(blocks.cross, 1, 2))
    local = solve_local(factors, blocks.local_gradient)
    reduced = blocks.shared + jnp.diag(_damped(jnp.diag(blocks.shared), damping))
    reduced = reduced - jnp.einsum("vkd,vdj->kj", blocks.cross, coupling)
    rhs = blocks.shared_gradient - jnp.einsum("vkd,vd->k", blocks.cross, local)
    return reduced, coupling, rhs, local


def _damped(diagonal: Float[Array, " n"], damping: Float[Array, ""]) -> Float[Array, " n"]:
    # Held parameters and padding have empty columns; a 1 keeps the matrix regular and their step 0.
    return jnp.where(diagonal > 0, damping * diagonal, 1.0).astype(diagonal.dtype)
