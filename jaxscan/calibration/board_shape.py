"""Which shape a board may have: the one that predicts best views that had no part in the solve.

The normal equations of a solve are sums over placements of the board. Without those of some
placements, their solution is the solve of all others, one Gauss-Newton step from the minimum; the
placements left out then find their own pose, and their residuals tell how good the model is.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.adjust import Adjustment, adjust_further, undetermined_shares
from jaxscan.calibration.joint import used_length
from jaxscan.calibration.problem import BoardModes, with_modes
from jaxscan.calibration.result import BoardMap, Calibration
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.errors import CalibrationError
from jaxscan.geometry import BowedBoard, bend_functions
from jaxscan.observation import Observations


PRINT_DEGREE = 3
"""Highest degree of the polynomials by which a print may be out of place."""
# Root mean square size [m] that a mode is expected to have: heights of degree 2, prints of degree 1,
# both less by a factor per degree.
_HEIGHT, _PRINT, _FALL = 4e-4, 1e-4, 0.6
# Part of a function that is left beside the functions before it, below which it is one of them.
_DEPENDENT = 1e-6
_HEIGHTS, _PRINTS = 23, 16


def smooth_modes(board: np.ndarray, frame: np.ndarray, padded: int) -> BoardModes:
    """Heights and prints that are polynomials.

    Heights hold no plane and no bow along x or y, prints no motion of the plane and no scale: those
    are unknowns of their own. Over the corners all are orthogonal.
    """
    place = (board[:, :2] - frame[:2]) / frame[2:]
    functions = np.stack(bend_functions(place), axis=-1)
    degree = _degrees(functions.shape[1])
    order = sorted(range(len(degree)), key=lambda i: (degree[i] > 1 and not _is_bow(degree, i), degree[i]))
    taken, combined = _orthogonal(functions[:, order])
    heights = [i for i in range(len(taken)) if degree[order[taken[i]]] > 1 and not _is_bow(degree, order[taken[i]])]
    size = np.array([_HEIGHT * _FALL ** (degree[order[taken[i]]] - 2) for i in heights])
    coefficients = np.zeros((_HEIGHTS, functions.shape[1]))
    coefficients[: len(heights), order] = (combined[:, heights] * size).T
    corner = np.zeros((padded, 3, _HEIGHTS + _PRINTS))
    corner[: len(board), 2, :_HEIGHTS] = functions @ coefficients.T
    prints = _prints(board, functions[:, degree <= PRINT_DEGREE], degree)
    corner[: len(board), :2, _HEIGHTS : _HEIGHTS + prints.shape[-1]] = prints
    return BoardModes(corner, coefficients)


def bent_modes(smooth: BoardModes) -> BoardModes:
    """The smooth modes that are heights; the others move nothing, so that the solve has the same size."""
    corner = smooth.corner.copy()
    corner[..., len(smooth.height) :] = 0.0
    return BoardModes(corner, smooth.height)


def _degrees(count: int) -> np.ndarray:
    """Total degree of each of `bend_functions`."""
    return np.array([degree for degree in range(count) for _ in range(degree + 1)][:count])


def _is_bow(degree: np.ndarray, index: int) -> bool:
    """Whether a function is a square of x alone or of y alone."""
    return bool(degree[index] == 2) and index != 4


def _prints(board: np.ndarray, functions: np.ndarray, degree: np.ndarray) -> Float[np.ndarray, "corners 2 prints"]:
    zero = np.zeros_like(functions)
    pairs = np.stack([np.stack([functions, zero], 1), np.stack([zero, functions], 1)], axis=-1)
    fields = pairs.reshape(2 * len(board), -1)
    motions = _motions(board)
    taken, combined = _orthogonal(np.concatenate([motions, fields], axis=1))
    kept = [i for i, column in enumerate(taken) if column >= motions.shape[1]]
    of = np.repeat(degree[: functions.shape[1]], 2)
    size = np.array([_PRINT * _FALL ** (of[taken[i] - motions.shape[1]] - 1) for i in kept])
    unit = np.concatenate([motions, fields], axis=1) @ combined[:, kept]
    return (unit * size).reshape(len(board), 2, -1)


def _motions(board: np.ndarray) -> Float[np.ndarray, "rows 4"]:
    """Shifts of the corners in the plane by two motions, a turn, and a change of scale; x and y of each corner."""
    x, y = (board[:, :2] - board[:, :2].mean(0)).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    pairs = ((one, zero), (zero, one), (-y, x), (x, y))
    return np.stack([np.stack(pair, -1).ravel() for pair in pairs], axis=-1)


def _orthogonal(columns: Float[np.ndarray, "rows n"]) -> tuple[list[int], Float[np.ndarray, "n m"]]:
    """The columns that are not combinations of columns before them, in order, made orthogonal."""
    size = np.linalg.norm(columns, axis=0)
    taken: list[int] = []
    units, combined = np.zeros((len(columns), 0)), np.zeros((columns.shape[1], 0))
    for index in range(columns.shape[1]):
        rest, how = columns[:, index] / size[index], np.eye(columns.shape[1])[index] / size[index]
        for _ in range(2):
            parts = units.T @ rest
            rest, how = rest - units @ parts, how - combined @ parts
        left = float(np.linalg.norm(rest))
        if left > _DEPENDENT:
            taken.append(index)
            units = np.column_stack([units, rest / left])
            combined = np.column_stack([combined, how / left])
    return taken, combined * np.sqrt(len(columns))


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
    """Whether each of the first `count` modes exists and moves a corner."""
    moving = np.any(modes.corner != 0, axis=(0, 1))
    return np.pad(moving, (0, count - len(moving)))


def _left_out(
    result: Adjustment, normal: _Normal, whole: np.ndarray, gradient: np.ndarray, kept: np.ndarray
) -> HeldOut:
    """The residuals of the views left out, with some of the unknowns alone."""
    owner = np.asarray(result.problem.placement)
    used = np.any(result.corner_inlier, axis=1)
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
    counted = result.corner_inlier & (weight > 0)
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
    corner_chain, stripe_chain = (
        np.asarray(part)[..., : shared + 6] for part in (linear.chains.corner, linear.chains.stripe)
    )
    # A mode moves a corner of the board as a shift of the whole board would.
    moved = slopes[..., camera : camera + 3].reshape(len(slopes), -1, 2, 3) @ extra.corner[None]
    moved = moved.reshape(*slopes.shape[:2], -1)
    residual = linear.corner_error * np.repeat(problem.corner_weight, 2, axis=1)
    # Without the padding at the end: stripes have thousands of rows.
    lit = slice(used_length(problem.stripe_used))
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
    """The information with 1 on the diagonal of placements that were not seen."""
    empty = np.trace(information, axis1=1, axis2=2) == 0
    return information + empty[:, None, None] * np.eye(information.shape[-1])


FreeShape = Literal["parabola", "bent", "smooth"]
# Fewer placements are too few to leave some out.
_LEAST_PLACEMENTS = 8
# A shape must raise the likelihood of the views left out by this much (natural logarithm) ...
_LEAST_GAIN = 10.0
# ... and be better for more placements than half of them by this many standard deviations of a toss-up.
_LEAST_SIGNIFICANCE = 2.0


class ShapeChoice(NamedTuple):
    """The shape of the board that was freed, and residuals of views that were left out."""

    free: FreeShape
    before_px: float | None = None
    """Root mean square corner distance of the views left out, with a parabola [px]; None where nobody has tried."""
    after_px: float | None = None
    """The same with the shape that was chosen."""


def choose_shape(
    result: Adjustment, observations: Observations, settings: CalibrationSettings
) -> tuple[Adjustment, ShapeChoice]:
    """The solve with the shape of the board that predicts best; call in 64 bit.

    Whether other shapes are worth a solve is seen to first order from the solve that is there.

    Args:
        result: The solve with a parabola.
        observations: Its observations.
        settings: Settings of the solve; the shape stays a parabola where "shape" or "warp" is held.
    """
    stay = result, ShapeChoice("parabola")
    placements = len(np.unique(result.data.placement[result.view_inlier & result.data.fixes_pose]))
    wanted = {"shape", "warp"} <= set(settings.free)
    if not wanted or not result.converged or placements < _LEAST_PLACEMENTS:
        return stay
    if undetermined_shares(result.linearised, np.asarray(result.problem.scales)).any():
        return stay
    board, frame = np.asarray(observations.board.corners(), np.float64), np.asarray(result.problem.frame)
    smooth = smooth_modes(board, frame, len(result.data.board))
    bent = bent_modes(smooth)
    before, *promises = hold_out(result, (bent, smooth))
    parabola = result, ShapeChoice("parabola", _rms(before), _rms(before))
    if not any(_is_better(promise, before, result) for promise in promises):
        return parabola
    # The fewest unknowns first.
    best, last = result, before
    free: FreeShape = "parabola"
    shapes: list[tuple[FreeShape, BoardModes]] = [("bent", bent), ("smooth", smooth)]
    for name, modes in shapes:
        promise = hold_out(best, (modes,))[1]
        found = _solved(best, modes, settings) if _is_better(promise, last, best) else None
        after = last if found is None else hold_out(found)[0]
        if found is not None and _is_better(after, last, best):
            best, last, free = found, after, name
    return best, ShapeChoice(free, _rms(before), _rms(last))


def _solved(result: Adjustment, modes: BoardModes, settings: CalibrationSettings) -> Adjustment | None:
    """The solve with other modes; None where it finds no minimum."""
    try:
        found = adjust_further(result, with_modes(result.problem, modes, settings), settings)
    except CalibrationError:
        # The parabola did find one, and is kept.
        return None
    return found if found.converged else None


def _is_better(after: HeldOut, before: HeldOut, result: Adjustment) -> bool:
    """Whether one model predicts the views that were left out better than another, beyond chance."""
    both = after.counted & before.counted
    squares = lambda held: np.where(both, np.sum(held.error**2, axis=-1) / result.corner_sigma**2, 0.0).sum(1)
    used = both.any(1)
    owner = np.unique(result.data.placement[used], return_inverse=True)[1]
    gain = np.bincount(owner, (squares(before) - squares(after))[used])
    # Most placements must agree: a count, because few of them have most of the views.
    agreeing = 2 * np.count_nonzero(gain > 0) - len(gain)
    return bool(gain.sum() > 2 * _LEAST_GAIN and agreeing > _LEAST_SIGNIFICANCE * np.sqrt(len(gain)))


def _rms(held: HeldOut) -> float:
    return float(np.sqrt(np.sum(held.error**2) / max(int(held.counted.sum()), 1)))


def describe_board(
    result: Adjustment, observations: Observations, calibration: Calibration, choice: ShapeChoice
) -> BoardMap | None:
    """Heights over the best plane and places in it, of every corner, with their standard deviations.

    Returns:
        The map; None of a solve that did not converge.
    """
    if not result.converged or calibration.fit is None:
        return None
    first = len(calibration.order)
    covariance = calibration.fit.covariance[first:, first:]
    board = np.asarray(observations.board.corners(), np.float64)
    shape = np.asarray(result.problem.shape)
    surface = BowedBoard(np.asarray(result.problem.frame), shape[:3])
    bow = np.asarray(surface.rise(board[:, :2]))
    modes = np.asarray(result.problem.modes.corner)[: len(board)]
    # The pitch moves the corners in the plane, and is reported by itself.
    numbers = np.array([0, 1, *range(3, len(shape))])
    heights = np.concatenate([bow, modes[:, 2]], axis=1)
    plane = np.column_stack([np.ones(len(board)), board[:, :2]])
    heights = heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]
    height = heights @ shape[numbers]
    shift = modes[:, :2] @ shape[3:]
    sigma = lambda slopes, part: np.sqrt(np.maximum(np.sum((slopes @ part) * slopes, axis=-1), 0.0))
    own = covariance[3:, 3:]
    return BoardMap(
        free=choice.free,
        rms_off_flat_m=float(np.sqrt(np.mean(height**2))),
        held_out_rms_parabola_px=choice.before_px,
        held_out_rms_px=choice.after_px,
        height_m=tuple(height.tolist()),
        height_sigma_m=tuple(sigma(heights, covariance[np.ix_(numbers, numbers)]).tolist()),
        shift_m=tuple((x, y) for x, y in shift.tolist()),
        shift_sigma_m=tuple(zip(*(sigma(modes[:, axis], own).tolist() for axis in (0, 1)), strict=True)),
    )
