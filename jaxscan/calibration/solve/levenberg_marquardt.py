"""Levenberg-Marquardt over one compiled linearisation, which covariance and leverages use too.

A step costs one call of `linearise_compiled`, and a small factorisation. The loop runs on the
host: so the rows of all residuals, by far the largest part to compile, are compiled once. Rule and
constants of the trust region are those of optimistix' `ClassicalTrustRegion`, and the minimum is
that of optimistix' solvers (`experiments/solver_time.py`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.solve.blocks import Blocks, schur_step
from jaxscan.calibration.solve.covariance import Linearised, linearise
from jaxscan.calibration.solve.problem import Problem, Step, move
from jaxscan.compiling import compile_quickly
from jaxscan.geometry import Array


# Relative rounding error of a sum of some ten thousand squares.
_ROUNDING = 1e-13
# A step is good, or acceptable, if the cost falls by this share of the promise; how the region grows and shrinks.
_GOOD, _ACCEPTABLE = 0.99, 0.01
_GROW, _SHRINK = 3.5, 0.25


class Solution(NamedTuple):
    """The end of a solve."""

    problem: Problem
    """The problem seen from the minimum."""
    linearised: Linearised
    """To first order there; NumPy arrays."""
    shared: Float[np.ndarray, " shared"]
    """The step of the shared unknowns to there, from the problem that was given [scaled units]."""
    steps: int
    """Linearisations, the first one included."""
    converged: bool
    """False where it stopped after its last step."""


class _Advance(NamedTuple):
    """A step, and the problem seen from its end."""

    problem: Problem
    step: Step
    promise: Float[Array, ""]
    """Change of the cost if the problem were linear."""


def solve(problem: Problem, damping: float, tolerance: float, max_steps: int) -> Solution:
    """Minimise half the sum of squares of all whitened residuals; call in 64 bit.

    Args:
        problem: With its weights.
        damping: Of the first step, relative to the diagonal of J'J [1].
        tolerance: Root mean square change of scaled unknowns and of whitened residuals at which
            to stop [1].
        max_steps: Linearisations at most, the first one included.
    """
    here = linearised_at(problem)
    shared, size = np.zeros(len(here.prior_residual)), 1.0
    for steps in range(2, max_steps + 1):
        found = _advance(problem, here.blocks, np.asarray(damping / size))
        there = linearised_at(found.problem)
        # The last steps change the cost by less than its last digit: a change by rounding alone is no worse.
        fall, promise = float(there.cost - here.cost), float(found.promise)
        same = abs(fall) <= _ROUNDING * float(here.cost)
        acceptable = fall <= _ACCEPTABLE * promise
        if not same or acceptable:
            size *= (_GROW if fall <= _GOOD * promise else 1.0) if acceptable else _SHRINK
        if not (acceptable or same):
            continue
        settled = _change(found.step, here, there, problem) < tolerance
        shared += np.asarray(found.step.shared)
        problem, here = found.problem, there
        if settled:
            return Solution(problem, here, shared, steps, True)
    return Solution(problem, here, shared, max_steps, False)


def linearised_at(problem: Problem) -> Linearised:
    """`linearise`, compiled, as NumPy arrays; call in 64 bit."""
    return jax.tree.map(np.asarray, linearise_compiled(problem))


def _compiled(function: Callable[[Problem], Linearised]) -> Callable[[Problem], Linearised]:
    # This option halves the time to compile, and hardly costs time to run.
    options: Any = {"compiler_options": {"xla_cpu_use_fusion_emitters": False}}
    return eqx.filter_jit(function, **options)


linearise_compiled = _compiled(linearise)
"""`linearise`, compiled; call in 64 bit."""


@compile_quickly
def _advance(problem: Problem, blocks: Blocks, damping: Float[Array, ""]) -> _Advance:
    shared, local = schur_step(blocks, damping)
    step = Step(-shared, -local)
    # Half a step of Gauss-Newton's own falls short of the gradient by the damping.
    along = jnp.vdot(blocks.shared_gradient, step.shared) + jnp.vdot(blocks.local_gradient, step.local)
    curved = jnp.vdot(step.shared, blocks.shared @ step.shared)
    curved += 2.0 * jnp.einsum("k,vkd,vd->", step.shared, blocks.cross, step.local)
    curved += jnp.einsum("vd,vde,ve->", step.local, blocks.local, step.local)
    return _Advance(move(step, problem), step, along + 0.5 * curved)


def _change(step: Step, here: Linearised, there: Linearised, problem: Problem) -> float:
    """Root mean square change of the unknowns, or of the whitened residuals, whichever is larger."""
    rms = lambda *parts: float(np.sqrt(sum(np.sum(np.square(p)) for p in parts) / max(sum(p.size for p in parts), 1)))
    corner = (there.corner_error - here.corner_error) * np.repeat(problem.corner_weight, 2, axis=1)
    stripe = (there.offset - here.offset) * problem.stripe_weight
    residual = rms(corner, stripe, there.prior_residual - here.prior_residual)
    return max(rms(np.asarray(step.shared), np.asarray(step.local)), residual)
