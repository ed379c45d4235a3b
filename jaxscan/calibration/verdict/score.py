r"""Scores of terms that the models of a solve do not have, and their covariance.

With residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra terms, all
whitened: $g = E^T r$ and $V = E^T E - E^T J (J^T J)^{-1} J^T E$. Nothing is solved again.

The derivatives are there from the solve, so this is host arithmetic.

Source: Rao's score test.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.solve.joint import Linearised
from jaxscan.calibration.solve.problem import Problem, corner_pixels, move, used_stops
from jaxscan.calibration.verdict.extra_terms import (
    Extents,
    board_terms,
    lens_terms,
    moving_twist,
    radial_terms,
    sheet_terms,
    turn_terms,
)
from jaxscan.leastsq import Unknowns


class Score(NamedTuple):
    """Gradient of the cost by extra terms of several models at the minimum, and its covariance."""

    gradient: Float[np.ndarray, " terms"]
    own: Float[np.ndarray, " terms"]
    """Diagonal of E'E: the variance if nothing were estimated."""
    variance: Float[np.ndarray, "terms terms"]
    taken: Float[np.ndarray, "terms shared"]
    """$(J^T J)^{-1} J^T E$: how the shared unknowns imitate each term."""
    places: dict[str, np.ndarray]
    """Positions of the terms of each model."""


class _System(NamedTuple):
    """J'J of all unknowns, and the derivatives of the rows of each view and stripe by those that it meets."""

    corner: Float[np.ndarray, "views rows unknowns"]
    stripe: Float[np.ndarray, "stripes points unknowns"]
    view_owner: np.ndarray
    stripe_owner: np.ndarray
    inverse: Float[np.ndarray, "all all"]
    shared: int
    own: Int[np.ndarray, "placements own"]
    """Where the pose and the stops of each placement stand among all unknowns; the last one stands for none."""

    def unknowns(self, placement: int | np.integer) -> Int[np.ndarray, " unknowns"]:
        """Where all that a placement meets stands."""
        return np.append(np.arange(self.shared), self.own[placement])


def score_models(problem: Problem, linearised: Linearised, extents: Extents) -> Score:
    """Score of every model; those of "axis", and of "table" where stops are exact, have as many terms a view, of
    `repeated_views`.

    Args:
        problem: At its minimum, with its weights.
        linearised: The same to first order.
        extents: For the coordinates of the terms.

    Returns:
        The score, with places of "lens", "radial" (a part of it), "board", and where there are any "table", "axis"
        and "sheet".
    """
    system = _system(problem, linearised)
    corner_weight, stripe_weight = np.repeat(problem.corner_weight, 2, axis=1), np.asarray(problem.stripe_weight)
    corner_error, offset = linearised.corner_error, linearised.offset
    corner_residual = corner_error * corner_weight
    # Terms are functions of where things should have been seen: at the noisy places themselves they
    # would be correlated with the noise.
    corner_q = np.asarray(problem.corner_q) + corner_error.reshape(problem.corner_q.shape)
    camera = len(problem.camera.parameter_names())
    twist = linearised.corner_slopes[..., camera : camera + 6]
    # Displacements of the image are weighted here, those of the board were when the rows were formed.
    lens, radial = (terms(corner_q, extents) * corner_weight[..., None] for terms in (lens_terms, radial_terms))
    board = board_terms(problem, twist[..., :3])
    bend = _mean_residual(problem, system) * corner_weight
    groups = {
        name: _shared(system, extra, corner_residual, system.corner, system.view_owner)
        for name, extra in (("lens", lens), ("radial", radial), ("board", board), ("bend", bend[..., None]))
    }
    # An axis that is held may have no views that show it.
    if problem.turntable.blocks and len(views := repeated_views(problem)):
        twist = twist[views]
        turn = moving_twist(linearised.view_poses[views], problem.turntable)
        turned, terms = np.einsum("vrd,vd->vr", twist, turn)[..., None], turn_terms(problem, views)
        if terms.shape[1] == len(views):
            groups["table"] = _by_view(system, turned, corner_residual, views)
        else:
            extra = np.zeros((*corner_residual.shape, terms.shape[1]))
            extra[views] = turned * terms[:, None]
            groups["table"] = _shared(system, extra, corner_residual, system.corner, system.view_owner)
        groups["axis"] = _by_view(system, twist, corner_residual, views)
    if len(problem.lasers.distance):
        by_q = linearised.by_q
        square = np.sum(by_q * by_q, axis=-1)
        stripe_q = np.asarray(problem.stripe_q) - by_q * (offset / np.where(square > 0, square, 1.0))[..., None]
        extra = sheet_terms(stripe_q, problem, extents) * (np.sqrt(square) * stripe_weight)[..., None]
        groups["sheet"] = _shared(system, extra, offset * stripe_weight, system.stripe, system.stripe_owner)
    return _joined(system, groups)


class _Terms(NamedTuple):
    """Terms of one model: gradient, products with the unknowns, and the terms themselves."""

    gradient: np.ndarray
    met: np.ndarray
    """J'E [terms, all]."""
    extra: np.ndarray
    """[owners, rows, terms], whitened."""
    striped: bool
    """Whether the rows are those of stripes rather than those of corners."""
    views: np.ndarray | None = None
    """The views that have terms of their own; None where all views or stripes share them."""


def _joined(system: _System, groups: dict[str, _Terms]) -> Score:
    """All terms as one score: different models may explain the same residuals."""
    counts = np.cumsum([0, *(len(group.gradient) for group in groups.values())])
    places = {name: np.arange(*ends) for name, *ends in zip(groups, counts[:-1], counts[1:], strict=True)}
    met = np.concatenate([group.met for group in groups.values()])
    gradient = np.concatenate([group.gradient for group in groups.values()])
    gram = np.zeros((len(met),) * 2)
    for one, first in groups.items():
        for other, second in groups.items():
            if places[one][0] <= places[other][0] and first.striped == second.striped:
                block = _products(first, second)
                gram[np.ix_(places[one], places[other])] = block
                gram[np.ix_(places[other], places[one])] = block.T
    solved = met @ system.inverse
    variance = gram - solved @ met.T
    # The mean of the residuals is one more term, of known size, that the unknowns imitate in part.
    (bend,) = places.pop("bend")
    for name in ("lens", "radial", "board"):
        gradient[places[name]] -= variance[places[name], bend]
    return Score(gradient, np.diag(gram).copy(), variance, solved[:, : system.shared], places)


def _products(first: _Terms, second: _Terms) -> np.ndarray:
    """E'E of two models."""
    ahead = first.extra if second.views is None or first.views is not None else first.extra[second.views]
    each = np.swapaxes(ahead, 1, 2) @ second.extra
    views, one, other = each.shape
    if second.views is None:
        return each.sum(0)
    if first.views is None:
        return np.moveaxis(each, 0, 1).reshape(one, views * other)
    block = np.zeros((views, one, views, other))
    block[np.arange(views), :, np.arange(views)] = each
    return block.reshape(views * one, views * other)


def repeated_views(problem: Problem) -> np.ndarray:
    """Numbers of the views in use whose placement was seen from several angles: only there can a turn be wrong."""
    placement, used = np.asarray(problem.placement), np.any(np.asarray(problem.corner_weight) > 0, axis=1)
    count = np.bincount(placement[used], minlength=len(placement))
    return np.flatnonzero(used & (count[placement] > 1))


def _system(problem: Problem, linearised: Linearised) -> _System:
    corner = linearised.corner_slopes @ linearised.corner_chain
    stripe = linearised.stripe_slopes @ linearised.stripe_chain
    view_owner = np.asarray(problem.placement)
    stripe_owner = view_owner[np.asarray(problem.stripe_view)]
    shared, placements = len(problem.scales), len(problem.poses)
    used = used_stops(problem)
    own = np.full((placements, problem.own), -1)
    own[:, :6] = shared + np.arange(6 * placements).reshape(placements, 6)
    own[:, 6:][used] = shared + 6 * placements + np.arange(used.sum())
    whole = np.zeros((shared + 6 * placements + int(used.sum()) + 1,) * 2)
    whole[:shared, :shared] = linearised.prior
    # The records' positions are residuals of the stops.
    stops = own[:, 6:][used]
    whole[stops, stops] = 1.0
    system = _System(corner, stripe, view_owner, stripe_owner, whole, shared, own)
    for values, owner in ((corner, view_owner), (stripe, stripe_owner)):
        for gram, number in zip(np.swapaxes(values, 1, 2) @ values, owner, strict=True):
            met = system.unknowns(number)
            whole[np.ix_(met, met)] += gram
    # Held unknowns and padding meet nothing.
    size = np.sqrt(np.where(np.diag(whole) > 0, np.diag(whole), 1.0))
    whole[np.diag_indices(len(whole))] = np.where(np.diag(whole) > 0, np.diag(whole), 1.0)
    inverse = np.linalg.inv(whole / np.outer(size, size)) / np.outer(size, size)
    return system._replace(inverse=inverse)


def _shared(system: _System, extra: np.ndarray, residual: np.ndarray, rows: np.ndarray, owner: np.ndarray) -> _Terms:
    """Of terms that every view or stripe has in common."""
    met = np.zeros((extra.shape[-1], len(system.inverse)))
    for own, number in zip(np.swapaxes(extra, 1, 2) @ rows, owner, strict=True):
        met[:, system.unknowns(number)] += own
    gradient = extra.reshape(-1, extra.shape[-1]).T @ residual.ravel()
    return _Terms(gradient, met, extra, striped=rows is system.stripe)


def _by_view(system: _System, extra: np.ndarray, residual: np.ndarray, views: np.ndarray) -> _Terms:
    """Of terms of each view's own: those of all other views do not meet them."""
    count, _, terms = extra.shape
    met = np.zeros((count * terms, len(system.inverse)))
    for index, view in enumerate(views):
        here = slice(index * terms, (index + 1) * terms)
        met[here, system.unknowns(system.view_owner[view])] = extra[index].T @ system.corner[view]
    gradient = np.einsum("vrm,vr->vm", extra, residual[views]).ravel()
    return _Terms(gradient, met, extra, striped=False, views=views)


def _mean_residual(problem: Problem, system: _System) -> Float[np.ndarray, "views rows"]:
    r"""Mean of the corner residuals that the bend of the projection causes [px].

    $d = \frac{1}{2} \mathrm{tr}(H C)$, with $H$ the second derivatives of a residual and $C$ the covariance of the
    unknowns, less the part that the unknowns take up. Small, but terms that the unknowns imitate almost
    wholly are smaller.

    Source: Box, Bias in nonlinear estimation (1971).
    """
    count, size = system.shared, system.own.shape[1]
    covariance, cross = system.inverse[:count, :count], system.inverse[system.own, :count]
    # Any root of C will do: shared unknowns with the poses that follow them, then the poses alone, of
    # which those of different placements meet different views.
    root = np.linalg.cholesky(covariance)
    follow = np.moveaxis(cross @ np.linalg.solve(covariance, root), 2, 0)
    alone = system.inverse[system.own[:, :, None], system.own[:, None]]
    alone = alone - cross @ np.linalg.solve(covariance, np.moveaxis(cross, 1, 2))
    # Stops that are none stand beside each other in one place.
    none = (system.own < 0)[:, :, None] | (system.own < 0)[:, None]
    own = np.linalg.cholesky(np.where(none, np.eye(size), alone))
    shared = np.concatenate([root.T, np.zeros((size, count))])
    steps = Unknowns(shared, np.concatenate([follow, np.moveaxis(own, 2, 0)]))
    return _bend(problem, steps)


def _bend(problem: Problem, steps: Unknowns) -> Float[np.ndarray, "views rows"]:
    """Half the sum of second differences of the corner residuals along steps."""
    seen = np.flatnonzero(problem.seen)
    fields = ("corner_q", "corner_weight", "angle", "stop", "placement", "seen")
    parts: dict[str, Any] = {name: np.asarray(getattr(problem, name))[seen] for name in fields}
    some = replace(problem, **parts)
    here, total = corner_pixels(some), np.zeros(np.shape(problem.corner_q))
    for step in zip(*steps, strict=True):
        for sign in (1.0, -1.0):
            there = corner_pixels(move(Unknowns(*(sign * part for part in step)), some))
            total[seen] += 0.5 * (there - here)
    return total.reshape(len(total), -1)
