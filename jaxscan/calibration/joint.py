"""The joint problem as `leastsq` sees it, its solution by one compiled program, and the problem to first order."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.problem import Problem, camera_from_board, move, moving, shared_values, zero_step
from jaxscan.calibration.rows import Chains, Rows, chains, corner_rows, stripe_rows
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array
from jaxscan.leastsq import (
    AbstractProblem,
    Arrow,
    Covariance,
    Linear,
    Normal,
    Unknowns,
    covariance_of,
    minimised,
    reduce_arrow,
    sum_arrow,
)


class Residuals(NamedTuple):
    """Whitened residuals; corners and stripes lead with the axis of their view or stripe."""

    corner: Float[Array, "views rows"]
    """u and v of every corner."""
    stripe: Float[Array, "stripes points"]
    prior: Float[Array, " shared"]
    stop: Float[Array, "placements stops"]


class Seen(NamedTuple):
    """The problem at a point to first order, without weights."""

    corners: Rows
    """Projected minus observed corners, u and v of each [px]."""
    stripes: Rows
    """Distances e of the points, lifted to their boards, from their sheets [m]."""
    by_q: Float[Array, "stripes points 2"]
    """grad_q e [m / px]."""
    chain: Chains
    pose: Float[Array, "views 4 4"]
    """T_cam(phi)_board."""
    priors: Float[Array, "shared shared"]
    """Derivatives of the priors' residuals by the shared scaled unknowns."""


class Point(NamedTuple):
    """Values of the unknowns."""

    moved: Any
    """Camera, lasers, motion, poses and stops, shape of the board."""
    shared: Float[Array, " shared"]
    """The sum of all steps of the shared unknowns to there [scaled units]."""


class Joint(AbstractProblem):
    r"""All residuals, each in standard deviations.

    Corner: $(\pi(T_\varphi^{-1} T_b X) - q) / \sigma$. Stripe: the Sampson error
    $e / (\|\nabla_q e\| \sigma)$ with $e$ the distance from the laser sheet of the point where
    the ray of $q$ meets the board; it stays a pixel error at all ranges. Its gradient is part of
    the weight, and so constant during a solve.

    A block is the pose of a placement of the board, with the stops of the motion at which it was seen.

    Source: the paper, equations (5)-(8) and (10), made one problem.
    """

    problem: Problem

    def linearise(self, y: Point) -> tuple[Residuals, Linear]:
        """Derivatives are by steps from the point, in its own frames."""
        problem = _at(self.problem, y.moved)
        seen = _seen(problem)
        corner, stripe = jnp.repeat(problem.corner_weight, 2, axis=1), problem.stripe_weight
        residuals = Residuals(seen.corners.value * corner, seen.stripes.value * stripe, priors(problem), problem.stops)
        placement, chain = problem.placement, seen.chain
        (corners, stripes, *_), slopes = seen, seen.priors
        sums = [
            Normal(corners.square, corners.gradient, placement, chain.corner),
            Normal(stripes.square, stripes.gradient, problem.stripe_placement(), chain.stripe),
            Normal((slopes.T @ slopes)[None], (slopes.T @ residuals.prior)[None]),
            _stops_alone(problem),
        ]
        return residuals, Linear(sum_arrow(sums, len(problem.scales), (len(problem.poses), problem.own)), seen)

    def move(self, y: Point, step: Unknowns) -> Point:
        """See `problem.move`."""
        return Point(moving(move(step, _at(self.problem, y.moved))), y.shared + step.shared)


def priors(problem: Problem) -> Float[Array, " shared"]:
    """Departures from the values expected before any image, in standard deviations."""
    return (shared_values(problem) - problem.expected) * problem.prior_weight


def _stops_alone(problem: Problem) -> Normal:
    """The positions of the records, which stops are residuals of."""
    gradient = jnp.pad(problem.stops, ((0, 0), (len(problem.scales) + 6, 0)))
    square = jnp.diag(jnp.where(jnp.arange(gradient.shape[1]) < len(problem.scales) + 6, 0.0, 1.0))
    square = jnp.broadcast_to(square.astype(gradient.dtype), (*gradient.shape, len(square)))
    return Normal(square, gradient, jnp.arange(len(gradient)))


def _at(problem: Problem, moved: Any) -> Problem:
    return eqx.tree_at(moving, problem, moved)


# Traced once, however often optimistix looks at the problem.
@jax.jit
def _seen(problem: Problem) -> Seen:
    start = zero_step(problem)
    rows = corner_rows(problem), *stripe_rows(problem)
    slopes = jax.jacfwd(lambda shared: priors(move(start._replace(shared=shared), problem)))(start.shared)
    return Seen(*rows, chains(problem), camera_from_board(problem), slopes)


@dataclass(frozen=True)
class Linearised:
    """The problem at the point that it holds, to first order; scaled units, on the host."""

    problem: Problem
    arrow: Arrow
    """The normal equations."""
    corner_error: Float[np.ndarray, "views rows"]
    """Projected minus observed corners, u and v of each [px]."""
    offset: Float[np.ndarray, "stripes points"]
    """Distance e of a stripe point, lifted to its board, from its sheet [m]."""
    by_q: Float[np.ndarray, "stripes points 2"]
    """grad_q e [m / px]."""
    view_poses: Float[np.ndarray, "views 4 4"]
    """T_cam(phi)_board of every view."""
    residuals: Residuals
    prior_slopes: Float[np.ndarray, "shared shared"]
    """Derivatives of the priors' residuals."""
    chains: Chains
    """Derivatives of the departures by the shared unknowns and those of the view's placement."""
    corner_slopes: Float[np.ndarray, "views rows departures"]
    """Derivatives of the whitened rows by the departures of their view."""
    stripe_slopes: Float[np.ndarray, "stripes points of_stripes"]

    @cached_property
    def slope(self) -> Float[np.ndarray, "stripes points"]:
        """|grad_q e|: change of the distance over one pixel across the stripe [m / px]."""
        return np.hypot(self.by_q[..., 0], self.by_q[..., 1])

    @property
    def prior(self) -> Float[np.ndarray, "shared shared"]:
        """The part of the information that comes from the priors."""
        return self.prior_slopes.T @ self.prior_slopes

    @cached_property
    def reduced(self) -> Float[np.ndarray, "shared shared"]:
        """Information of the shared unknowns, poses and stops eliminated; 1 on the diagonal of held ones."""
        return np.asarray(reduce_arrow(self.arrow).information)

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of all unknowns."""
        return covariance_of(self.arrow)

    @cached_property
    def corner_leverage(self) -> Float[np.ndarray, "views rows"]:
        """Share of each whitened residual that the fit takes up, 0 ... 1 [1]."""
        return _leverage(self.corner_slopes, self.chains.corner, self.covariance.of(np.asarray(self.problem.placement)))

    @cached_property
    def stripe_leverage(self) -> Float[np.ndarray, "stripes points"]:
        """The same share for the residuals of stripes [1]."""
        owner = np.asarray(self.problem.stripe_placement())
        return _leverage(self.stripe_slopes, self.chains.stripe, self.covariance.of(owner))


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


def solve(problem: Problem, damping: float, tolerance: float, max_steps: int) -> Solution:
    """Minimise half the sum of squares of all whitened residuals; call in 64 bit.

    One program is compiled for each size of the arrays, whatever the weights and whoever asks.

    Args:
        problem: With its weights.
        damping: Damping of the first step, relative to the diagonal of J'J [1].
        tolerance: Root mean square change of scaled unknowns and of whitened residuals at which
            to stop [1].
        max_steps: Linearisations at most, the first one included.

    Raises:
        CalibrationError: If the point to begin with is not finite.
    """
    start = Point(moving(problem), np.zeros_like(problem.scales))
    found = minimised(Joint(problem), start, damping, tolerance, max_steps)
    if not found.steps:
        raise CalibrationError("The solve left the range of numbers: the observations contradict each other.")
    (arrow, seen), problem = found.linear, _at(problem, found.y.moved)
    corners, stripes = seen.corners, seen.stripes
    end = Linearised(
        problem,
        arrow,
        corners.value,
        stripes.value,
        seen.by_q,
        seen.pose,
        found.residuals,
        seen.priors,
        seen.chain,
        corners.slopes * np.repeat(problem.corner_weight, 2, axis=1)[..., None],
        stripes.slopes * np.asarray(problem.stripe_weight)[..., None],
    )
    return Solution(end, found.y.shared, int(found.steps), bool(found.converged))


def linearise(problem: Problem) -> Linearised:
    """The problem to first order at the point that it holds; call in 64 bit."""
    return solve(problem, 1.0, 1.0, 1).linearised


def used_length(there: Bool[Array, " owners"]) -> int:
    """How many views or stripes there are without the padding at the end."""
    return int(np.max(np.flatnonzero(there), initial=-1)) + 1


def _leverage(slopes: np.ndarray, chain: Array, covariance: np.ndarray) -> Float[np.ndarray, "owners rows"]:
    # The covariance of a view's departures, then that of each row.
    departures = np.asarray(chain)
    small = departures @ covariance @ np.swapaxes(departures, 1, 2)
    return np.sum((slopes @ small) * slopes, axis=-1)
