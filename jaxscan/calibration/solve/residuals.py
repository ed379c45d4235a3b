"""The whitened residuals of the joint problem: corners, stripes on boards, weak priors."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.calibration.solve.problem import Problem, Step, move, shared_values
from jaxscan.calibration.solve.rows import corner_rows, departures, stripe_rows
from jaxscan.geometry import Array


class Residuals(NamedTuple):
    """Whitened residuals; corners and stripes lead with the axis of their view or stripe."""

    corner: Float[Array, "views rows"]
    """u and v of every corner."""
    stripe: Float[Array, "stripes points"]
    prior: Float[Array, " shared"]


def residuals(step: Step, problem: Problem) -> Residuals:
    r"""All residuals, each in standard deviations.

    Corner: $(\pi(T_\varphi^{-1} T_b X) - q) / \sigma$. Stripe: the Sampson error
    $e / (\|\nabla_q e\| \sigma)$ with $e$ the distance from the laser sheet of the point where
    the ray of $q$ meets the board; it stays a pixel error at all ranges. Its gradient is part of
    the weight, and so constant during a solve.

    Source: the paper, equations (5)-(8) and (10), made one problem.
    """
    moved = move(step, problem)
    # The derivatives are formed once per point, not once per unknown: the part that depends on the step is
    # linear in a few departures per view.
    fixed = jax.lax.stop_gradient(moved)
    corners, (stripes, _) = corner_rows(fixed), stripe_rows(fixed)
    away = departures(step, problem)
    corner = corners.value + jnp.einsum("vrd,vd->vr", corners.slopes, away.corner)
    stripe = stripes.value + jnp.einsum("spd,sd->sp", stripes.slopes, away.stripe)
    return Residuals(
        corner * jnp.repeat(problem.corner_weight, 2, axis=1), stripe * problem.stripe_weight, priors(moved)
    )


def priors(problem: Problem) -> Float[Array, " shared"]:
    """Departures from the values expected before any image, in standard deviations."""
    return (shared_values(problem) - problem.expected) * problem.prior_weight
