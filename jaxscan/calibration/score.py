r"""The score test of the models of a finished solve: would terms that they do not have be worth having?

With residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra terms, all whitened, and
$g = E^T r$,

$$T = g^T V^{-1} g, \qquad V = E^T E - E^T J (J^T J)^{-1} J^T E$$

is chi-squared with as many degrees of freedom as terms that the unknowns cannot imitate (Rao). Nothing is solved again.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.adjust import Adjustment
from jaxscan.calibration.problem import LEAST_STOP_SIGMA, Problem, corner_pixels, move
from jaxscan.calibration.stops import faults_of_motion
from jaxscan.geometry import AbstractMotion
from jaxscan.leastsq import Unknowns


_LENS_DEGREE, _HEIGHT_DEGREE, _PRINT_DEGREE = 6, 4, 3
_RADIAL_POWERS = (4, 5)
# Degrees of the sheet along the stripe, and across it.
_SHEET_DEGREES = (5, 1)


class Score(NamedTuple):
    """Gradient of the cost by extra terms of several models at the minimum, and its covariance."""

    gradient: Float[np.ndarray, " terms"]
    own: Float[np.ndarray, " terms"]
    """Diagonal of E'E: the variance if nothing were estimated."""
    variance: Float[np.ndarray, "terms terms"]
    taken: Float[np.ndarray, "terms shared"]
    """$(J^T J)^{-1} J^T E$: how the shared unknowns imitate each term."""
    places: dict[str, Int[np.ndarray, " _own"]]
    """Positions of the terms of each model: "lens", "radial" (a part of it), "board", "paper", and where there are any
    "table", "axis" and "sheet"."""
    shapes: dict[str, np.ndarray]
    """What a unit of each term does: to corners [views, rows, terms], px, for lens and radial; to stripe points
    [stripes, points, terms], px, for the sheet; to positions of the motion [views, terms], rad or m, for the table."""


class _Single(NamedTuple):
    """Terms that every view or placement has for itself."""

    terms: Float[np.ndarray, "owners rows terms"]
    of: Int[np.ndarray, " owners"]
    """The number of each owner's terms, -1 for none."""


class _Rows(NamedTuple):
    """The residuals of corners or of stripe points, by view or by stripe, and what changes them."""

    common: dict[str, np.ndarray]
    """Terms of each model that all owners share [owners, rows, terms], whitened as all here."""
    single: dict[str, _Single]
    slopes: np.ndarray
    """Derivatives by camera, pose and sheet [owners, rows, own]."""
    chain: np.ndarray
    """Derivatives of these by the unknowns, the shared ones first [owners, own, unknowns]."""
    block: np.ndarray
    """Number of the block of own unknowns, among them the board's pose, of each owner [owners]."""
    residual: np.ndarray
    """[owners, rows]."""


def score_models(result: Adjustment) -> Score:
    """Score of every model at the minimum of a solve.

    Terms of "axis", and of "table" where stops are exact, are those of single views, of `repeated_views`; those of
    "paper" are of single placements.
    """
    used = np.any(np.asarray(result.problem.corner_weight) > 0, axis=1)
    boards = np.unique(np.asarray(result.problem.placement)[used])
    of_placement = _numbers(boards, len(result.problem.poses))
    corners, shapes = _corner_rows(result, of_placement)
    groups = [corners]
    if len(result.problem.lasers.distance):
        stripes, shapes["sheet"] = _stripe_rows(result, of_placement)
        groups.append(stripes)
    score = _score(result, groups, shapes)
    (bend,) = score.places.pop("bend")
    for name in ("lens", "radial", "board"):
        score.gradient[score.places[name]] -= score.variance[score.places[name], bend]
    return score


def _corner_rows(result: Adjustment, of_placement: np.ndarray) -> tuple[_Rows, dict[str, np.ndarray]]:
    """Rows of the corners, and the shapes of `Score`; placements by the numbers of their terms."""
    problem, linear, (width, height) = result.problem, result.linearised, result.data.size
    half, views = np.array([width, height]) / 2.0, repeated_views(problem)
    weight = np.repeat(np.asarray(problem.corner_weight), 2, axis=1)
    camera = len(problem.camera.parameter_names())
    twist = linear.corner_slopes[..., camera : camera + 6]
    shapes = _lens_terms((seen_corners(result) - (half - 0.5)) / half, half)
    # Displacements of the image are weighted here, those of the board were when the rows were formed.
    common = {name: terms * weight[..., None] for name, terms in shapes.items()}
    common["board"] = _board_terms(problem, twist[..., :3])
    # The mean of the residuals is one more term, of known size, that the unknowns imitate in part.
    common["bend"] = (_mean_residual(result) * weight)[..., None]
    bent = twist[..., 2, None] * np.repeat(bends(problem, np.asarray(problem.board)[:, :2]), 2, axis=0)
    single = {"paper": _Single(bent, of_placement[np.asarray(problem.placement)])}
    # An axis that is held may have no views that show it.
    if problem.turntable.blocks and len(views):
        of_view = _numbers(views, len(weight))
        shapes["table"] = _turn_terms(problem, views)
        turned = np.einsum("vrd,vd->vr", twist, moving_twist(linear.view_poses, problem.turntable))[..., None]
        if shapes["table"].shape[1] == len(views):
            single["table"] = _Single(turned, of_view)
        else:
            common["table"] = np.zeros((*turned.shape[:2], shapes["table"].shape[1]))
            common["table"][views] = turned[views] * shapes["table"][:, None]
        single["axis"] = _Single(twist, of_view)
    residual = linear.corner_error * weight
    chain, block = np.asarray(linear.chains.corner), np.asarray(problem.placement)
    return _Rows(common, single, linear.corner_slopes, chain, block, residual), shapes


def _stripe_rows(result: Adjustment, of_placement: np.ndarray) -> tuple[_Rows, np.ndarray]:
    """Rows of the stripe points, and the shape of the sheet's terms."""
    problem, linear = result.problem, result.linearised
    camera, weight, shape = (
        len(problem.camera.parameter_names()),
        np.asarray(problem.stripe_weight),
        _sheet_terms(result),
    )
    owner, twist = np.asarray(problem.stripe_placement()), linear.stripe_slopes[..., camera : camera + 6]
    # A turn about x lifts a point by its y, one about y lowers it by its x.
    rise = np.where(weight > 0, twist[..., 2], 1.0)
    bent = rise[..., None] * bends(problem, np.stack([-twist[..., 4], twist[..., 3]], -1) / rise[..., None])
    single = {"paper": _Single(np.where(weight[..., None] > 0, bent, 0.0), of_placement[owner])}
    common, chain = {"sheet": shape * (linear.slope * weight)[..., None]}, np.asarray(linear.chains.stripe)
    return _Rows(common, single, linear.stripe_slopes, chain, owner, linear.offset * weight), shape


def _score(result: Adjustment, groups: list[_Rows], shapes: dict[str, np.ndarray]) -> Score:
    """The sums over all rows, without what the unknowns imitate."""
    problem, known = result.problem, result.linearised.covariance
    sizes = {name: terms.shape[-1] for rows in groups for name, terms in rows.common.items()}
    # Corners have all terms that stripe points have for themselves, and of every placement.
    sizes |= {name: (int(of.max()) + 1) * terms.shape[-1] for name, (terms, of) in groups[0].single.items()}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    places = {name: np.arange(*part) for name, *part in zip(sizes, ends[:-1], ends[1:], strict=True)}
    count, shared = ends[-1], len(problem.scales)
    gradient, gram, met = np.zeros(count), np.zeros((count, count)), np.zeros((count, shared))
    met_by = np.zeros((len(problem.poses), count, problem.own))
    for rows in groups:
        common = np.concatenate([places[name] for name in rows.common])
        every = np.concatenate(list(rows.common.values()), axis=-1)
        for number in np.flatnonzero(np.any(rows.residual, axis=1)).tolist():
            terms, columns = every[number], common
            for name, (values, of) in rows.single.items():
                if of[number] >= 0:
                    terms = np.concatenate([terms, values[number]], axis=1)
                    own = places[name].reshape(-1, values.shape[-1])[of[number]]
                    columns = np.concatenate([columns, own])
            gradient[columns] += terms.T @ rows.residual[number]
            gram[np.ix_(columns, columns)] += terms.T @ terms
            times = terms.T @ rows.slopes[number] @ rows.chain[number]
            met[columns] += times[:, :shared]
            met_by[rows.block[number], columns] += times[:, shared:]
    # Poses and stops are eliminated, then the shared unknowns.
    side = np.moveaxis(met_by, 1, 0).reshape(count, -1)
    followed = np.moveaxis(met_by @ known.alone, 1, 0).reshape(count, -1)
    left = met - side @ known.coupling.reshape(-1, shared)
    taken = left @ known.shared
    variance = gram - followed @ side.T - taken @ left.T
    return Score(gradient, np.diag(gram).copy(), variance, taken, places, shapes)


def _numbers(there: Int[np.ndarray, " there"], count: int) -> Int[np.ndarray, " count"]:
    """The place of each number in a list, -1 where it is not there."""
    number = np.full(count, -1)
    number[there] = np.arange(len(there))
    return number


def repeated_views(problem: Problem) -> Int[np.ndarray, " repeated"]:
    """Numbers of the views in use whose placement was seen from several angles: only there can a turn be wrong."""
    placement, used = np.asarray(problem.placement), np.any(np.asarray(problem.corner_weight) > 0, axis=1)
    count = np.bincount(placement[used], minlength=len(placement))
    return np.flatnonzero(used & (count[placement] > 1))


def seen_corners(result: Adjustment) -> Float[np.ndarray, "views corners 2"]:
    """Where corners should have been seen [px]: terms of the noisy places would be correlated with the noise."""
    observed = np.asarray(result.problem.corner_q)
    return observed + result.linearised.corner_error.reshape(observed.shape)


def _mean_residual(result: Adjustment) -> Float[np.ndarray, "views rows"]:
    r"""Mean of the corner residuals that the bend of the projection causes [px].

    $d = \frac{1}{2} \mathrm{tr}(H C)$, with $H$ the second derivatives of a residual and $C$ the covariance of the
    unknowns. Small, but terms that the unknowns imitate almost wholly are smaller.

    Source: Box, Bias in nonlinear estimation (1971).
    """
    problem, known = result.problem, result.linearised.covariance
    # Any root of C will do: shared unknowns with the poses that follow them, then the poses alone, of which those of
    # different placements meet different views.
    root, alone = np.linalg.cholesky(known.shared), np.linalg.cholesky(known.alone)
    follow = np.moveaxis(-known.coupling @ root, 2, 0)
    steps = [*zip(root.T, follow, strict=True)]
    used = 6 + int(np.any(problem.stop, axis=0).sum())
    steps += [(np.zeros(len(root)), alone[..., number]) for number in range(used)]
    seen = np.flatnonzero(problem.view_used)
    fields = ("corner_q", "corner_weight", "angle", "stop", "placement", "view_used")
    parts: dict[str, Any] = {name: np.asarray(getattr(problem, name))[seen] for name in fields}
    some = replace(problem, **parts)
    here, total = corner_pixels(some), np.zeros(np.shape(problem.corner_q))
    weight = np.asarray(some.corner_weight)[..., None]
    for shared, local in steps:
        back, forth = (corner_pixels(move(Unknowns(sign * shared, sign * local), some)) for sign in (-1.0, 1.0))
        bend = 0.5 * (back + forth) - here
        if np.any(shared):
            # Where two lenses that are alike meet, the first order lets a step go anywhere: there the bend itself, at
            # one standard deviation of all corners, is what ends it.
            bend = bend / max(float(np.linalg.norm(bend * weight)), 1.0)
        total[seen] += bend
    return total.reshape(len(total), -1)


def _lens_terms(where: Float[np.ndarray, "views corners 2"], half: np.ndarray) -> dict[str, np.ndarray]:
    """Displacements of the image [views, rows, terms], px, by the place in it, -1 ... 1 of its half size."""
    field, away = _polynomials(where, _LENS_DEGREE), where * half / np.linalg.norm(half)
    along, across = np.stack([field, np.zeros_like(field)], 2), np.stack([np.zeros_like(field), field], 2)
    square = np.sum(away * away, axis=-1)[..., None]
    terms = {
        "lens": np.concatenate([along, across], axis=-1),
        "radial": np.stack([away * square**power for power in _RADIAL_POWERS], axis=-1),
    }
    return {name: part.reshape(len(part), -1, part.shape[-1]) for name, part in terms.items()}


def _board_terms(problem: Problem, shift: Float[np.ndarray, "views rows 3"]) -> Float[np.ndarray, "views rows terms"]:
    """Shapes of the board: prints that are not true, along x and y, and polynomial heights [px]."""
    where = (np.asarray(problem.board)[:, :2] - problem.frame[:2]) / problem.frame[2:]
    parts = zip(np.moveaxis(shift, -1, 0), (_PRINT_DEGREE, _PRINT_DEGREE, _HEIGHT_DEGREE), strict=True)
    return np.concatenate(
        [by[..., None] * np.repeat(_polynomials(where, degree), 2, axis=0) for by, degree in parts], axis=-1
    )


def bends(problem: Problem, xy: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 3"]:
    """Heights of the second degree at places on the board."""
    x, y = np.moveaxis((xy - problem.frame[:2]) / problem.frame[2:], -1, 0)
    return np.stack([x * x, x * y, y * y], axis=-1)


def _sheet_terms(result: Adjustment) -> Float[np.ndarray, "stripes points terms"]:
    """Displacements of the stripe of each laser that are polynomials of the place where it should have been [px]."""
    problem, linear, data = result.problem, result.linearised, result.data
    square = np.where(linear.slope > 0, linear.slope, 1.0) ** 2
    q = np.asarray(problem.stripe_q) - linear.by_q * (linear.offset / square)[..., None]
    points = data.stripe_q[data.stripe_valid] if data.stripe_valid.any() else np.zeros((1, 2))
    low, high = points.min(0), points.max(0)
    half = np.maximum((high - low) / 2, 1.0)
    where = (q - (low + high) / 2) / half
    # Along the stripe any shape, across it (near and far) little.
    long = int(np.argmax(half))
    along, across = (
        np.stack([where[..., axis] ** i for i in range(degree + 1)], -1)
        for axis, degree in zip((long, 1 - long), _SHEET_DEGREES, strict=True)
    )
    field = (along[..., :, None] * across[..., None, :]).reshape(*where.shape[:2], -1)
    lasers = np.arange(len(problem.lasers.distance))
    own = np.asarray(problem.stripe_laser)[:, None, None, None] == lasers[None, None, :, None]
    return np.where(own, field[:, :, None, :], 0.0).reshape(*where.shape[:2], -1)


def _polynomials(where: Float[np.ndarray, "... 2"], degree: int) -> Float[np.ndarray, "... terms"]:
    """Products of Chebyshev's polynomials, which are less alike than powers."""
    chebyshev = [np.ones_like(where), where]
    for _ in range(degree - 1):
        chebyshev.append(2.0 * where * chebyshev[-1] - chebyshev[-2])
    pairs = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([chebyshev[i][..., 0] * chebyshev[j][..., 1] for i, j in pairs], axis=-1)


def _turn_terms(problem: Problem, views: Int[np.ndarray, " repeated"]) -> Float[np.ndarray, "repeated terms"]:
    """Errors of the motion's positions at some views [rad or m]."""
    if float(problem.stop_sigma) <= LEAST_STOP_SIGMA:
        return np.eye(len(views))
    faults, stop = faults_of_motion(problem), np.asarray(problem.stop)[views]
    return np.einsum("vs,vst->vt", stop, faults[np.asarray(problem.placement)[views]])


def moving_twist(pose: Float[np.ndarray, "... 4 4"], motion: AbstractMotion) -> Float[np.ndarray, "... 6"]:
    """Twist (translation, rotation) in the axes of a board at T_cam_board that a motion by 1 rad or 1 m gives it."""
    # The camera moves, so the board moves the other way.
    back = np.swapaxes(pose[..., :3, :3], -1, -2)
    speed, axis = np.split(np.asarray(motion.twist()), 2)
    shift = speed + np.cross(axis, pose[..., :3, 3])
    return -np.concatenate([(back @ shift[..., None])[..., 0], back @ axis], axis=-1)
