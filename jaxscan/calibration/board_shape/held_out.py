"""Residuals of views that had no part in a solve, to first order, without solving again.

The normal equations of a solve are sums over placements of the board. Without those of some
placements, their solution is the solve of all others, one Gauss-Newton step from the minimum; the
placements left out then find their own pose, and their residuals tell how good the model is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.solve.adjustment import Adjustment
from jaxscan.calibration.solve.joint import used_length
from jaxscan.calibration.solve.problem import BoardModes
from jaxscan.geometry import bend_functions


FOLDS = 4
"""Every placement is left out once, together with every fourth other."""


class HeldOut(NamedTuple):
    """Residuals of the corners of every view, from solves without it."""

    error: Float[np.ndarray, "views corners 2"]
    """Projected minus observed [px]; 0 where a corner does not count."""
    counted: Float[np.ndarray, "views corners"]
    """bool: corners that the solve kept."""


class _Normal(NamedTuple):
    """The part of every placement in the normal equations, its pose eliminated; and its corner rows."""

    information: Float[np.ndarray, "placements unknowns unknowns"]
    gradient: Float[np.ndarray, "placements unknowns"]
    rows: Float[np.ndarray, "views rows unknowns"]
    pose_rows: Float[np.ndarray, "views rows 6"]
    residual: Float[np.ndarray, "views rows"]


def hold_out(result: Adjustment, candidates: Sequence[BoardModes] = ()) -> list[HeldOut]:
    """Residuals of views that were left out: of the solve as it is, then with more modes of the board's shape.

    Args:
        result: A solve that converged.
        candidates: Modes to add, each a part of the last ones; of those that are not 0, some may be in the solve.
    """
    own, shared = result.problem.modes, len(result.problem.scales)
    widest = candidates[-1] if candidates else own
    there = lambda modes: _moving(modes, widest.corner.shape[-1])
    extra = there(widest) & ~there(own)
    heights = extra[: len(widest.height)]
    normal = _normal(result, BoardModes(widest.corner[..., extra], widest.height[heights]))
    information = normal.information.sum(0)
    prior = np.eye(len(information))
    prior[:shared, :shared] = result.linearised.prior
    # At the minimum the gradient of the solve's own unknowns is 0, priors included.
    gradient = normal.gradient.sum(0)
    gradient[:shared] = 0.0
    kept = [np.arange(shared)]
    kept += [np.concatenate([kept[0], shared + np.flatnonzero(there(modes)[extra])]) for modes in candidates]
    return [_left_out(result, normal, information + prior, gradient, unknowns) for unknowns in kept]


def _moving(modes: BoardModes, count: int) -> np.ndarray:
    """Which of so many modes are there and move a corner."""
    moving = np.any(modes.corner != 0, axis=(0, 1))
    return np.pad(moving, (0, count - len(moving)))


def _left_out(
    result: Adjustment, normal: _Normal, whole: np.ndarray, gradient: np.ndarray, kept: np.ndarray
) -> HeldOut:
    """With some of the unknowns alone."""
    owner = np.asarray(result.problem.placement)
    used = np.any(result.corner_kept, axis=1)
    fold = np.full(len(normal.information), -1)
    there = np.unique(owner[used])
    fold[there] = np.arange(len(there)) % FOLDS
    residual = np.zeros_like(normal.residual)
    for number in range(FOLDS):
        out = fold == number
        left = (whole - normal.information[out].sum(0))[np.ix_(kept, kept)]
        size = np.sqrt(np.where(np.diag(left) > 0, np.diag(left), 1.0))
        scaled = left / np.outer(size, size)
        # Held unknowns meet nothing.
        scaled[np.diag_indices(len(kept))] += np.diag(left) <= 0
        right = (gradient - normal.gradient[out].sum(0))[kept] / size
        step = -np.linalg.solve(scaled, right) / size
        views = np.flatnonzero(out[owner] & used)
        residual[views] = normal.residual[views] + normal.rows[views][..., kept] @ step
    _find_poses(residual, normal.pose_rows, owner)
    weight = np.asarray(result.problem.corner_weight)
    error = residual.reshape(*weight.shape, 2) / np.where(weight > 0, weight, 1.0)[..., None]
    counted = result.corner_kept & (weight > 0)
    return HeldOut(np.where(counted[..., None], error, 0.0), counted)


def _find_poses(residual: np.ndarray, rows: np.ndarray, owner: np.ndarray) -> None:
    """Take off the part that the pose of each placement can explain."""
    count = int(owner.max()) + 1
    information, gradient = np.zeros((count, 6, 6)), np.zeros((count, 6))
    np.add.at(information, owner, np.swapaxes(rows, 1, 2) @ rows)
    np.add.at(gradient, owner, np.einsum("vrd,vr->vd", rows, residual))
    step = -np.linalg.solve(_regular(information), gradient[..., None])[..., 0]
    residual += np.einsum("vrd,vd->vr", rows, step[owner])


def _normal(result: Adjustment, extra: BoardModes) -> _Normal:
    problem, linear = result.problem, result.linearised
    camera, shared, modes = len(problem.camera.parameter_names()), len(problem.scales), extra.corner.shape[-1]
    slopes = linear.corner_slopes
    # Without the stops, which are at their minimum.
    corner_chain, stripe_chain = (part[..., : shared + 6] for part in (linear.corner_chain, linear.stripe_chain))
    # A mode moves a corner of the board as a shift of the whole board would.
    moved = slopes[..., camera : camera + 3].reshape(len(slopes), -1, 2, 3) @ extra.corner[None]
    moved = moved.reshape(*slopes.shape[:2], -1)
    residual = linear.corner_error * np.repeat(problem.corner_weight, 2, axis=1)
    # Without the padding at the end: stripes have thousands of rows.
    lit = slice(used_length(problem.lit))
    stripe_slopes, stripe_chain = linear.stripe_slopes[lit], stripe_chain[lit]
    lifted = _lifted(stripe_slopes[..., camera : camera + 6], extra, np.asarray(problem.frame))
    offset = linear.offset[lit] * np.asarray(problem.stripe_weight)[lit]
    owner, stripe_owner = np.asarray(problem.placement), np.asarray(problem.stripe_placement())[lit]
    count, unknowns = len(problem.poses), shared + modes + 6
    information, gradient = np.zeros((count, unknowns, unknowns)), np.zeros((count, unknowns))
    for parts, chain, values, number in (
        ((slopes, moved), corner_chain, residual, owner),
        ((stripe_slopes, lifted), stripe_chain, offset, stripe_owner),
    ):
        # Thousands of rows share the few departures of their view: these are summed, then led to the unknowns.
        rows = np.concatenate(parts, axis=-1)
        upright, follow = np.swapaxes(rows, 1, 2), _follow(chain, modes)[:, : rows.shape[-1]]
        np.add.at(information, number, np.swapaxes(follow, 1, 2) @ (upright @ rows) @ follow)
        np.add.at(gradient, number, ((upright @ values[..., None])[..., 0][:, None, :] @ follow)[:, 0])
    cross = information[:, :-6, -6:]
    coupling = cross @ np.linalg.inv(_regular(information[:, -6:, -6:]))
    every = np.concatenate((slopes, moved), axis=-1) @ _follow(corner_chain, modes)
    return _Normal(
        information[:, :-6, :-6] - coupling @ np.swapaxes(cross, 1, 2),
        gradient[:, :-6] - np.einsum("pud,pd->pu", coupling, gradient[:, -6:]),
        every[..., :-6],
        every[..., -6:],
        residual,
    )


def _follow(chain: np.ndarray, modes: int) -> Float[np.ndarray, "owners departures unknowns"]:
    """Derivatives of departures and extra modes by the shared unknowns, the extra modes, and the pose."""
    owners, numbers, unknowns = chain.shape
    follow = np.zeros((owners, numbers + modes, unknowns + modes))
    follow[:, :numbers, : unknowns - 6] = chain[..., :-6]
    follow[:, :numbers, -6:] = chain[..., -6:]
    follow[:, numbers:, unknowns - 6 : unknowns - 6 + modes] = np.eye(modes)
    return follow


def _lifted(twist: np.ndarray, extra: BoardModes, frame: np.ndarray) -> Float[np.ndarray, "stripes points heights"]:
    """Derivatives of stripe rows by the first extra modes, which are heights; the others move no stripe."""
    if not len(extra.height):
        return np.zeros((*twist.shape[:2], 0))
    # A turn about x lifts a point by its y, one about y lowers it by its x.
    along = twist[..., 2]
    safe = np.where(along == 0, 1.0, along)
    place = np.stack([-twist[..., 4] / safe, twist[..., 3] / safe], axis=-1)
    lifted = np.zeros((*along.shape, len(extra.height)))
    # Stripe by stripe, so that the functions of its thousand points stay in the processor's cache.
    for own, where, rise in zip(lifted, (place - frame[:2]) / frame[2:], along, strict=True):
        own[...] = (extra.height @ np.stack(bend_functions(where)) * rise).T
    return lifted


def _regular(information: np.ndarray) -> np.ndarray:
    """With 1 on the diagonal of placements that nobody saw."""
    empty = np.trace(information, axis1=1, axis2=2) == 0
    return information + empty[:, None, None] * np.eye(information.shape[-1])
