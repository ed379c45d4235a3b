r"""Scores of terms that the models of a solve do not have, and their covariance.

With residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra terms, all
whitened: $g = E^T r$ and $V = E^T E - E^T J (J^T J)^{-1} J^T E$. Nothing is solved again.

Source: Rao's score test.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.covariance import chains, gram, prior_information, sum_blocks
from jaxscan.calibration.extra_terms import (
    Extents,
    board_terms,
    lens_terms,
    radial_terms,
    sheet_terms,
    turning_twist,
)
from jaxscan.calibration.problem import Problem, Step, camera_from_board, move, zero_step
from jaxscan.calibration.rows import corner_rows, stripe_rows
from jaxscan.calibration.solve import Blocks, reduce_blocks, schur_step
from jaxscan.geometry import Array


class Score(NamedTuple):
    """Gradient of the cost by extra terms at the minimum, and its covariance."""

    gradient: Float[Array, " terms"]
    own: Float[Array, " terms"]
    """Diagonal of E'E: what the variance would be if nothing were estimated."""
    variance: Float[Array, "terms terms"]
    taken: Float[Array, "terms shared"]
    """$(J^T J)^{-1} J^T E$: how the shared unknowns imitate each term."""

    def only(self, keep: np.ndarray) -> "Score":
        """The score of some of the terms."""
        return Score(self.gradient[keep], self.own[keep], self.variance[np.ix_(keep, keep)], self.taken[keep])


@eqx.filter_jit
def score_models(problem: Problem, extents: Extents) -> dict[str, Score]:
    """Scores of every model; those of table and axis have as many terms a view, of all views."""
    corners, (stripes, by_q) = corner_rows(problem), stripe_rows(problem)
    # Terms are functions of where things should have been seen: at the noisy places themselves they
    # would be correlated with the noise.
    square = jnp.sum(by_q * by_q, axis=-1)
    stripe_q = problem.stripe_q - by_q * (stripes.value / jnp.where(square > 0, square, 1.0))[..., None]
    corner_q = problem.corner_q + corners.value.reshape(problem.corner_q.shape)
    corner_weight = jnp.repeat(problem.corner_weight, 2, axis=1)
    corner_slopes = corners.slopes * corner_weight[..., None]
    stripe_slopes = stripes.slopes * problem.stripe_weight[..., None]
    corner_residual = corners.value * corner_weight
    chain = chains(problem)
    view_owner, stripe_owner = problem.placement, problem.stripe_placement()
    blocks = sum_blocks(
        gram(corner_slopes, chain.corner),
        gram(stripe_slopes, chain.stripe),
        prior_information(problem)[1],
        view_owner,
        stripe_owner,
        len(problem.poses),
    )
    camera = len(problem.camera.parameter_names())

    bend = _mean_residual(problem, blocks) * corner_weight

    def test_corners(extra: Array) -> Score:
        # The mean of the residuals is one more term, of known size, that the unknowns imitate in part.
        whole = jnp.concatenate([extra * corner_weight[..., None], bend[..., None]], axis=-1)
        score = test_everywhere(whole, corner_residual, corner_slopes, chain.corner, view_owner)
        gradient = score.gradient[:-1] - score.variance[:-1, -1]
        return Score(gradient, score.own[:-1], score.variance[:-1, :-1], score.taken[:-1])

    def test_everywhere(extra: Array, residual: Array, slopes: Array, chain: Array, owner: Array) -> Score:
        met = jnp.einsum("vrm,vrd,kvd->vmk", extra, slopes, chain)
        own = jnp.einsum("vrm,vrn->mn", extra, extra)
        return _score(blocks, jnp.einsum("vrm,vr->m", extra, residual), own, met, owner)

    def test_views(extra: Array) -> Score:
        # Terms of each view's own: those of all other views do not meet them.
        views, _, terms = extra.shape
        met = jnp.einsum("vrm,vrd,kvd->vmk", extra, corner_slopes, chain.corner)
        own = jnp.einsum("vrm,vrn->vmn", extra, extra)
        apart = jnp.eye(views, dtype=extra.dtype)
        gradient = jnp.einsum("vrm,vr->vm", extra, corner_residual).ravel()
        spread = jnp.einsum("vmk,vw->vwmk", met, apart).reshape(views, views * terms, met.shape[2])
        whole = jnp.einsum("vmn,vw->vmwn", own, apart).reshape(views * terms, views * terms)
        return _score(blocks, gradient, whole, spread, view_owner)

    twist = corner_slopes[..., camera : camera + 6]
    scores = {
        "lens": test_corners(lens_terms(corner_q, extents)),
        # Of all that a lens may do besides, the next powers of the radius are the likeliest; two terms
        # are noticed where a hundred would drown them.
        "radial": test_corners(radial_terms(corner_q, extents)),
        "board": test_corners(board_terms(problem, corners.slopes[..., camera : camera + 3])),
    }
    if problem.turntable is not None:
        table = problem.turntable
        turn = jax.vmap(lambda pose: turning_twist(pose, table))(camera_from_board(problem))
        scores["table"] = test_views(jnp.einsum("vrd,vd->vr", twist, turn)[..., None])
        scores["axis"] = test_views(twist)
    if len(problem.lasers.distance):
        scores["sheet"] = test_everywhere(
            sheet_terms(stripe_q, problem, extents) * (jnp.sqrt(square) * problem.stripe_weight)[..., None],
            stripes.value * problem.stripe_weight,
            stripe_slopes,
            chain.stripe,
            stripe_owner,
        )
    return scores


def _score(blocks: Blocks, gradient: Array, own: Array, met: Array, owner: Array) -> Score:
    """Score and covariance of extra terms, from what they have in common with the unknowns.

    Args:
        blocks: Of J'J.
        gradient: E'r.
        own: E'E.
        met: E'J of every view or stripe, by the shared unknowns and its pose [owners, terms, unknowns].
        owner: Placement of each.
    """
    count = len(blocks.shared)
    shared = met[:, :, :count].sum(0)
    local = jnp.zeros((len(blocks.local), len(own), 6), own.dtype).at[owner].add(met[:, :, count:])

    def solved(shared_side, local_side):
        return schur_step(
            Blocks(blocks.shared, blocks.cross, blocks.local, shared_side, local_side), jnp.zeros((), own.dtype)
        )

    by_shared, by_local = jax.vmap(solved, in_axes=(0, 1))(shared, local)
    taken = shared @ by_shared.T + jnp.einsum("pmd,npd->mn", local, by_local)
    return Score(gradient, jnp.diagonal(own), own - taken, by_shared)


def _mean_residual(problem: Problem, blocks: Blocks) -> Float[Array, "views rows"]:
    r"""What the bend of the projection leaves in the mean of the corner residuals [px].

    $d = \frac{1}{2} \mathrm{tr}(H C)$, with $H$ the second derivatives of a residual and $C$ the covariance of the
    unknowns, less what the unknowns take up of it. Small, but terms that the unknowns imitate almost
    wholly are smaller.

    Source: Box, Bias in nonlinear estimation (1971).
    """
    reduced, coupling, _, _ = reduce_blocks(blocks, jnp.zeros((), blocks.shared.dtype))
    root = jnp.linalg.cholesky(jnp.linalg.inv(reduced))
    empty = jnp.diagonal(blocks.local, axis1=1, axis2=2) == 0
    filled = blocks.local + jax.vmap(jnp.diag)(empty.astype(root.dtype))
    own = jnp.linalg.cholesky(jnp.linalg.inv(filled))
    errors = lambda step: corner_rows(move(step, problem)).value
    here = errors(zero_step(problem))

    def bend(step):
        back = jax.tree.map(jnp.negative, step)
        return errors(step) + errors(back) - 2.0 * here

    shared = Step(root.T, -jnp.einsum("vdk,kj->jvd", coupling, root))
    local = Step(jnp.zeros((6, len(root)), root.dtype), jnp.moveaxis(own, 2, 0))
    steps = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), shared, local)
    return 0.5 * jax.lax.scan(lambda total, step: (total + bend(step), None), jnp.zeros_like(here), steps)[0]
