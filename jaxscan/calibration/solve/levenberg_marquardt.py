"""Levenberg-Marquardt over the linearisation that covariance and leverages use too; a loop on the host.

Only errors and their derivatives are compiled (`evaluate`), by far the largest part of the work. Rule and constants
of the trust region are those of optimistix' `ClassicalTrustRegion`, and the minimum is that of optimistix' solvers
(`experiments/solver_time.py`).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.solve.blocks import Blocks, schur_step
from jaxscan.calibration.solve.evaluate import Evaluated, moved
from jaxscan.calibration.solve.linearised import Linearised, linearise, squares
from jaxscan.calibration.solve.problem import Problem, Step


# Relative rounding error of a sum of some ten thousand squares.
_ROUNDING = 1e-13
# A step is good, or acceptable, if the cost falls by this share of the promise; how the region grows and shrinks.
_GOOD, _ACCEPTABLE = 0.99, 0.01
_GROW, _SHRINK = 3.5, 0.25


class Solution(NamedTuple):
    """The end of a solve."""

    linearised: Linearised
    """The problem seen from the minimum, to first order."""
    shared: Float[np.ndarray, " shared"]
    """The step of the shared unknowns to there, from the problem that was given [scaled units]."""
    steps: int
    """Linearisations, the first one included."""
    converged: bool
    """False where it stopped after its last step."""

    @property
    def problem(self) -> Problem:
        """The problem seen from the minimum."""
        return self.linearised.problem


def solve(
    problem: Problem, damping: float, tolerance: float, max_steps: int, *, at: Evaluated | None = None
) -> Solution:
    """Minimise half the sum of squares of all whitened residuals; call in 64 bit.

    Args:
        problem: With its weights.
        damping: Of the first step, relative to the diagonal of J'J [1].
        tolerance: Root mean square change of scaled unknowns and of whitened residuals at which
            to stop [1].
        max_steps: Linearisations at most, the first one included.
        at: `evaluate` of the problem, where it is known.
    """
    here = linearise(problem, at)
    shared, size = np.zeros(len(here.prior_residual)), 1.0
    for steps in range(2, max_steps + 1):
        try:
            step = Step(*(-part for part in schur_step(here.blocks, damping / size)))
        except np.linalg.LinAlgError:
            # Rounding left a matrix that is not positive; more damping makes it so.
            size *= _SHRINK
            continue
        there = linearise(moved(step, here.problem))
        # The last steps change the cost by less than its last digit: a change by rounding alone is no worse.
        fall, promise = there.cost - here.cost, _promise(here.blocks, step)
        same = abs(fall) <= _ROUNDING * here.cost
        acceptable = fall <= _ACCEPTABLE * promise
        if not same or acceptable:
            size *= (_GROW if fall <= _GOOD * promise else 1.0) if acceptable else _SHRINK
        if not (acceptable or same):
            continue
        settled = _change(step, here, there) < tolerance
        shared += step.shared
        here = there
        if settled:
            return Solution(here, shared, steps, True)
    return Solution(here, shared, max_steps, False)


def _promise(blocks: Blocks, step: Step) -> float:
    """Change of the cost by a step if the problem were linear."""
    shared, local = np.asarray(step.shared), np.asarray(step.local)
    # Half a step of Gauss-Newton's own falls short of the gradient by the damping.
    along = np.vdot(blocks.shared_gradient, shared) + np.vdot(blocks.local_gradient, local)
    curved = shared @ blocks.shared @ shared + 2.0 * np.vdot(np.tensordot(shared, blocks.cross, (0, 1)), local)
    curved += np.vdot(local, (blocks.local @ local[..., None])[..., 0])
    return float(along + 0.5 * curved)


def _change(step: Step, here: Linearised, there: Linearised) -> float:
    """Root mean square change of the unknowns, or of the whitened residuals, whichever is larger."""
    rms = lambda *parts: float(np.sqrt(sum(map(squares, parts)) / max(sum(part.size for part in parts), 1)))
    corner = (there.corner_error - here.corner_error) * here.corner_weight
    stripe = (there.offset - here.offset) * np.asarray(here.problem.stripe_weight)
    residual = rms(corner, stripe, there.prior_residual - here.prior_residual)
    return max(rms(np.asarray(step.shared), np.asarray(step.local)), residual)
