r"""Scores of terms that the models of a solve do not have, and their covariance.

With residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra terms, all
whitened: $g = E^T r$ and $V = E^T E - E^T J (J^T J)^{-1} J^T E$. Nothing is solved again.

The derivatives are there from the solve, so this is host arithmetic.

Source: Rao's score test.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.solve.covariance import Linearised
from jaxscan.calibration.solve.problem import Problem, Step, move, zero_step
from jaxscan.calibration.solve.rows import corner_rows
from jaxscan.calibration.verdict.extra_terms import (
    Extents,
    board_terms,
    lens_terms,
    moving_twist,
    radial_terms,
    sheet_terms,
)
from jaxscan.geometry import Array


class Score(NamedTuple):
    """Gradient of the cost by extra terms at the minimum, and its covariance."""

    gradient: Float[np.ndarray, " terms"]
    own: Float[np.ndarray, " terms"]
    """Diagonal of E'E: the variance if nothing were estimated."""
    variance: Float[np.ndarray, "terms terms"]
    taken: Float[np.ndarray, "terms shared"]
    """$(J^T J)^{-1} J^T E$: how the shared unknowns imitate each term."""

    def only(self, keep: np.ndarray | slice) -> "Score":
        """The score of some of the terms."""
        return Score(self.gradient[keep], self.own[keep], self.variance[keep][:, keep], self.taken[keep])


class _System(NamedTuple):
    """J'J of all unknowns, and the derivatives of the rows of each view and stripe by those that it meets."""

    corner: Float[np.ndarray, "views rows unknowns"]
    stripe: Float[np.ndarray, "stripes points unknowns"]
    view_owner: np.ndarray
    stripe_owner: np.ndarray
    inverse: Float[np.ndarray, "all all"]
    shared: int


def score_models(problem: Problem, linearised: Linearised, extents: Extents) -> dict[str, Score]:
    """Scores of every model; those of "table" and "axis" have as many terms a view, of all views.

    Args:
        problem: At its minimum, with its weights.
        linearised: The same to first order.
        extents: For the coordinates of the terms.

    Returns:
        Scores of "lens", "radial" (a part of it), "board", and where there are any "table", "axis"
        and "sheet".
    """
    system = _system(problem, linearised)
    corner_weight, stripe_weight = np.repeat(problem.corner_weight, 2, axis=1), np.asarray(problem.stripe_weight)
    corner_error, offset = np.asarray(linearised.corner_error), np.asarray(linearised.offset)
    corner_residual = corner_error * corner_weight
    # Terms are functions of where things should have been seen: at the noisy places themselves they
    # would be correlated with the noise.
    corner_q = np.asarray(problem.corner_q) + corner_error.reshape(problem.corner_q.shape)
    camera = len(problem.camera.parameter_names())
    twist = np.asarray(linearised.corner_slopes)[..., camera : camera + 6]
    # Displacements of the image are weighted here, those of the board were when the rows were formed.
    lens, radial = (terms(corner_q, extents) * corner_weight[..., None] for terms in (lens_terms, radial_terms))
    board = board_terms(problem, twist[..., :3])
    bend = _mean_residual(problem, system) * corner_weight
    extra = np.concatenate([lens, radial, board, bend[..., None]], axis=-1)
    everywhere = _score(system, extra, corner_residual, system.corner, system.view_owner)
    # The mean of the residuals is one more term, of known size, that the unknowns imitate in part.
    everywhere = everywhere._replace(gradient=everywhere.gradient - everywhere.variance[:, -1])
    ends = np.cumsum([terms.shape[-1] for terms in (lens, radial, board)])
    scores = {
        name: everywhere.only(slice(start, end))
        for name, start, end in zip(("lens", "radial", "board"), (0, *ends), ends, strict=False)
    }
    if problem.turntable.blocks:
        turn = moving_twist(np.asarray(linearised.view_poses), problem.turntable)
        scores["table"] = _score_views(system, np.einsum("vrd,vd->vr", twist, turn)[..., None], corner_residual)
        scores["axis"] = _score_views(system, twist, corner_residual)
    if len(problem.lasers.distance):
        by_q = np.asarray(linearised.by_q)
        square = np.sum(by_q * by_q, axis=-1)
        stripe_q = np.asarray(problem.stripe_q) - by_q * (offset / np.where(square > 0, square, 1.0))[..., None]
        extra = sheet_terms(stripe_q, problem, extents) * (np.sqrt(square) * stripe_weight)[..., None]
        scores["sheet"] = _score(system, extra, offset * stripe_weight, system.stripe, system.stripe_owner)
    return scores


def _system(problem: Problem, linearised: Linearised) -> _System:
    by_unknowns = lambda slopes, chain: np.asarray(slopes) @ np.moveaxis(np.asarray(chain), 0, -1)
    corner = by_unknowns(linearised.corner_slopes, linearised.corner_chain)
    stripe = by_unknowns(linearised.stripe_slopes, linearised.stripe_chain)
    view_owner = np.asarray(problem.placement)
    stripe_owner = view_owner[np.asarray(problem.stripe_view)]
    shared, placements = len(problem.scales), len(problem.poses)
    whole = np.zeros((shared + 6 * placements,) * 2)
    whole[:shared, :shared] = np.asarray(linearised.prior)
    for values, owner in ((corner, view_owner), (stripe, stripe_owner)):
        for gram, number in zip(np.swapaxes(values, 1, 2) @ values, owner, strict=True):
            met = _unknowns(shared, number)
            whole[np.ix_(met, met)] += gram
    # Held unknowns and padding meet nothing.
    size = np.sqrt(np.where(np.diag(whole) > 0, np.diag(whole), 1.0))
    whole[np.diag_indices(len(whole))] = np.where(np.diag(whole) > 0, np.diag(whole), 1.0)
    inverse = np.linalg.inv(whole / np.outer(size, size)) / np.outer(size, size)
    return _System(corner, stripe, view_owner, stripe_owner, inverse, shared)


def _unknowns(shared: int, placement: int | np.integer) -> np.ndarray:
    """Where the shared unknowns and the pose of a placement stand among all unknowns."""
    return np.concatenate([np.arange(shared), shared + 6 * placement + np.arange(6)])


def _score(system: _System, extra: np.ndarray, residual: np.ndarray, rows: np.ndarray, owner: np.ndarray) -> Score:
    """Of terms that every view or stripe has in common."""
    met = np.zeros((extra.shape[-1], len(system.inverse)))
    for own, number in zip(np.swapaxes(extra, 1, 2) @ rows, owner, strict=True):
        met[:, _unknowns(system.shared, number)] += own
    flat = extra.reshape(-1, extra.shape[-1])
    return _finish(system, flat.T @ residual.ravel(), flat.T @ flat, met)


def _score_views(system: _System, extra: np.ndarray, residual: np.ndarray) -> Score:
    """Of terms of each view's own: those of all other views do not meet them."""
    views, _, terms = extra.shape
    met = np.zeros((views * terms, len(system.inverse)))
    own = np.zeros((views * terms,) * 2)
    for view in range(views):
        here = slice(view * terms, (view + 1) * terms)
        met[here, _unknowns(system.shared, system.view_owner[view])] = extra[view].T @ system.corner[view]
        own[here, here] = extra[view].T @ extra[view]
    return _finish(system, np.einsum("vrm,vr->vm", extra, residual).ravel(), own, met)


def _finish(system: _System, gradient: np.ndarray, own: np.ndarray, met: np.ndarray) -> Score:
    solved = met @ system.inverse
    return Score(gradient, np.diag(own).copy(), own - solved @ met.T, solved[:, : system.shared])


def _mean_residual(problem: Problem, system: _System) -> Float[np.ndarray, "views rows"]:
    r"""Mean of the corner residuals that the bend of the projection causes [px].

    $d = \frac{1}{2} \mathrm{tr}(H C)$, with $H$ the second derivatives of a residual and $C$ the covariance of the
    unknowns, less the part that the unknowns take up. Small, but terms that the unknowns imitate almost
    wholly are smaller.

    Source: Box, Bias in nonlinear estimation (1971).
    """
    count = system.shared
    covariance, cross = system.inverse[:count, :count], system.inverse[count:, :count]
    # Any root of C will do: shared unknowns with the poses that follow them, then the poses alone, of
    # which those of different placements meet different views.
    root = np.linalg.cholesky(covariance)
    follow = (cross @ np.linalg.solve(covariance, root)).T.reshape(count, -1, 6)
    alone = system.inverse[count:, count:] - cross @ np.linalg.solve(covariance, cross.T)
    own = np.stack([np.linalg.cholesky(alone[i : i + 6, i : i + 6]) for i in range(0, len(alone), 6)])
    steps = Step(np.concatenate([root.T, np.zeros((6, count))]), np.concatenate([follow, np.moveaxis(own, 2, 0)]))
    return np.asarray(_bend(problem, steps))


@eqx.filter_jit
def _bend(problem: Problem, steps: Step) -> Array:
    """Half the sum of second differences of the corner residuals along steps."""
    errors = lambda step: corner_rows(move(step, problem)).value
    here = errors(zero_step(problem))

    def add(total, step):
        back = jax.tree.map(jnp.negative, step)
        return total + errors(step) + errors(back) - 2.0 * here, None

    return 0.5 * jax.lax.scan(add, jnp.zeros_like(here), steps)[0]
