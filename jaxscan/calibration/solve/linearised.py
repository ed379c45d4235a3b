"""The problem at a point, to first order: normal equations and leverages from errors and weights; on the host."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.solve.blocks import Blocks, Inverse, inverse_blocks, reduce_blocks
from jaxscan.calibration.solve.evaluate import Evaluated, evaluate
from jaxscan.calibration.solve.problem import Problem
from jaxscan.geometry import Array


@dataclass(frozen=True)
class Linearised:
    """The problem at the point that it holds, to first order; scaled unknowns. Parts are computed when asked for."""

    problem: Problem
    at: Evaluated
    """Without weights."""

    @property
    def corner_error(self) -> Float[np.ndarray, "views rows"]:
        """Projected minus observed corners, u and v of each [px]."""
        return np.asarray(self.at.corners.error)

    @property
    def offset(self) -> Float[np.ndarray, "stripes points"]:
        """Distance e of a stripe point, lifted to its board, from its sheet [m]."""
        return np.asarray(self.at.stripes.offset)

    @property
    def by_q(self) -> Float[np.ndarray, "stripes points 2"]:
        """grad_q e [m / px]."""
        return np.asarray(self.at.stripes.by_q)

    @cached_property
    def slope(self) -> Float[np.ndarray, "stripes points"]:
        """|grad_q e|: change of the distance over one pixel across the stripe [m / px]."""
        return np.hypot(self.by_q[..., 0], self.by_q[..., 1])

    @property
    def prior_residual(self) -> Float[np.ndarray, " shared"]:
        """Departures from expected values, in standard deviations."""
        return np.asarray(self.at.priors.residual)

    @property
    def view_poses(self) -> Float[np.ndarray, "views 4 4"]:
        """T_cam(phi)_board of every view."""
        return np.asarray(self.at.corners.pose)

    @property
    def corner_chain(self) -> Float[np.ndarray, "views departures unknowns"]:
        """Derivatives of the departures by the shared unknowns and the pose of the view."""
        return np.asarray(self.at.corners.chain)

    @property
    def stripe_chain(self) -> Float[np.ndarray, "stripes departures unknowns"]:
        """The same of stripes."""
        return np.asarray(self.at.stripes.chain)

    @cached_property
    def corner_weight(self) -> Float[np.ndarray, "views rows"]:
        """1 / sigma of every row [1 / px]."""
        return np.repeat(self.problem.corner_weight, 2, axis=1)

    @cached_property
    def corner_slopes(self) -> Float[np.ndarray, "views rows departures"]:
        """Derivatives of the whitened rows by the departures of their view."""
        return _weighed(self.at.corners.slopes, self.corner_weight, self.problem.seen)

    @cached_property
    def stripe_slopes(self) -> Float[np.ndarray, "stripes points departures"]:
        """The same of stripes."""
        return _weighed(self.at.stripes.slopes, self.problem.stripe_weight, self.problem.lit)

    @cached_property
    def cost(self) -> float:
        """Half the sum of squares of all whitened residuals, priors included [1]."""
        return 0.5 * sum(map(squares, (*self._residuals, self.prior_residual)))

    @cached_property
    def prior(self) -> Float[np.ndarray, "shared shared"]:
        """The part of the information that comes from the priors."""
        slopes = np.asarray(self.at.priors.slopes)
        return slopes.T @ slopes

    @cached_property
    def blocks(self) -> Blocks:
        """The normal equations."""
        placements, count = len(self.problem.poses), len(self.problem.scales)
        whole = np.zeros((placements, count + 6, count + 6))
        gradient = np.zeros((placements, count + 6))
        corner, stripe = self._residuals
        for there, slopes, chain, values, owner in (
            (self.problem.seen, self.corner_slopes, self.corner_chain, corner, self._owners[0]),
            (self.problem.lit, self.stripe_slopes, self.stripe_chain, stripe, self._owners[1]),
        ):
            used = slice(used_length(there))
            slopes, chain, values, owner = (part[used] for part in (slopes, chain, values, owner))
            # Thousands of rows share the few departures of their view: these are summed, then led to the unknowns.
            upright, follow = np.swapaxes(slopes, 1, 2), np.swapaxes(chain, 1, 2)
            np.add.at(whole, owner, follow @ (upright @ slopes) @ chain)
            np.add.at(gradient, owner, (follow @ (upright @ values[..., None]))[..., 0])
        return Blocks(
            whole[:, :count, :count].sum(0) + self.prior,
            whole[:, :count, count:],
            whole[:, count:, count:],
            gradient[:, :count].sum(0) + np.asarray(self.at.priors.slopes).T @ self.prior_residual,
            gradient[:, count:],
        )

    @cached_property
    def known_poses(self) -> Float[np.ndarray, " shared"]:
        """Diagonal of the information that there would be if all poses were known."""
        return np.diagonal(self.blocks.shared)

    @cached_property
    def reduced(self) -> Float[np.ndarray, "shared shared"]:
        """Information of the shared unknowns, poses eliminated; 1 on the diagonal of held ones."""
        return reduce_blocks(self.blocks, 0.0).information

    @cached_property
    def corner_leverage(self) -> Float[np.ndarray, "views rows"]:
        """Share of each whitened residual that the fit takes up, 0 ... 1 [1]."""
        return _leverage(self.corner_slopes, self.corner_chain, self._inverse.of(self._owners[0]))

    @cached_property
    def stripe_leverage(self) -> Float[np.ndarray, "stripes points"]:
        """The same of stripes."""
        return _leverage(self.stripe_slopes, self.stripe_chain, self._inverse.of(self._owners[1]))

    @cached_property
    def _inverse(self) -> Inverse:
        return inverse_blocks(self.blocks)

    @property
    def _owners(self) -> tuple[np.ndarray, np.ndarray]:
        """The placement of every view and stripe."""
        placement = np.asarray(self.problem.placement)
        return placement, placement[np.asarray(self.problem.stripe_view)]

    @cached_property
    def _residuals(self) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals of corners and stripes."""
        return self.corner_error * self.corner_weight, self.offset * np.asarray(self.problem.stripe_weight)


def used_length(there: Bool[Array, " owners"]) -> int:
    """How many views or stripes there are without the padding at the end."""
    return int(np.max(np.flatnonzero(there), initial=-1)) + 1


def squares(values: Float[np.ndarray, "..."]) -> float:
    """The sum of the squares."""
    # The product of BLAS wakes its threads for so few numbers, which takes longer than the sum.
    return float(np.sum(np.square(values)))


def linearise(problem: Problem, at: Evaluated | None = None) -> Linearised:
    """The problem to first order at the point that it holds; call in 64 bit.

    Args:
        problem: With its weights.
        at: `evaluate` of it, where that is known, perhaps with other weights.
    """
    return Linearised(problem, evaluate(problem) if at is None else at)


def _weighed(
    slopes: Array, weight: Array, there: Bool[Array, " owners"]
) -> Float[np.ndarray, "owners rows departures"]:
    # The padding at the end is 0 as it is.
    used = slice(used_length(there))
    whole = np.zeros(slopes.shape)
    np.multiply(slopes[used], np.asarray(weight)[used, :, None], out=whole[used])
    return whole


def _leverage(slopes: np.ndarray, chain: np.ndarray, covariance: np.ndarray) -> Float[np.ndarray, "owners rows"]:
    # The covariance of a view's departures, then that of each row.
    small = chain @ covariance @ np.swapaxes(chain, 1, 2)
    return np.sum((slopes @ small) * slopes, axis=-1)
