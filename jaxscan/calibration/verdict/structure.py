r"""Do the models of lens, board, table and sheet suffice? Tests of the residuals.

A score test (Rao) asks of every model whether terms that it does not have would be worth
having: with residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra
terms, all whitened, and $g = E^T r$,

$$T = g^T V^{-1} g, \qquad V = E^T E - E^T J (J^T J)^{-1} J^T E$$

is chi-squared with as many degrees of freedom as terms that the unknowns cannot imitate. Nothing
is solved again, the derivatives are there from the solve, and the failing model is named.
Cross-validations, by two halves of the records and by the middle of the image, ask the same of all
models together, and of the lens where no corner was seen.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.chi_squared import chance_of
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjustment import Adjustment
from jaxscan.calibration.solve.joint import Linearised
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import LEAST_STOP_SIGMA, Problem, corner_pixels, move, used_stops
from jaxscan.calibration.solve.stops import faults_of_motion
from jaxscan.calibration.verdict.cross_validation import Split, compare_halves, compare_regions
from jaxscan.calibration.verdict.limits import result_of_test
from jaxscan.calibration.verdict.quality import ModelTest
from jaxscan.geometry import AbstractMotion
from jaxscan.leastsq import Unknowns


# Directions in which the unknowns imitate the extra terms but for this share are left out: their
# remainder is as small as the second order of the projection, which is no noise. Of the next
# powers of the radius little else remains, and only their mean by second order is taken off.
_IMITATED = 1e-2
_RADIAL_IMITATED = 1e-3
# Stops that err by chance imitate a fault of the table but for the part that chance makes unlikely.
_TURN_IMITATED = 1e-6
_ORDER = ("lens", "board", "table", "axis", "sheet")
_REPEATED = 0.05
# Square of what noise alone gives a direction, at two standard deviations.
_CHANCE = 4.0
# Degrees of the polynomials.
_LENS_DEGREE = 6
_RADIAL_POWERS = (4, 5)
_HEIGHT_DEGREE = 4
_PRINT_DEGREE = 3
_SHEET_DEGREES = (5, 1)


class Extents(NamedTuple):
    """Centres and half sizes that make coordinates of image and stripes about -1 ... 1."""

    image: Float[np.ndarray, "2 2"]
    stripe: Float[np.ndarray, "2 2"]


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


class Missing(NamedTuple):
    """Terms that a model lacks, as far as the residuals show them, and their changes of terms found before.

    Terms of several models are in one order (`Score.places`).
    """

    size: np.ndarray
    """The residuals ask for `-size` of each term; less the part that noise alone would give, but of single views."""
    noise: np.ndarray
    """Root of the covariance of `size` as noise causes it [terms, seen]."""
    shift: np.ndarray
    """How far the shared unknowns would go [scaled units], to first order, if the model had these terms."""


class Judged(NamedTuple):
    """The tests of the models, and the terms that explain the structure in the residuals."""

    tests: tuple[ModelTest, ...]
    """"lens", "board", "table" (its angles), "axis" (whether it stands still), "sheet", "halves" and "regions", those
    that the data allow."""
    missing: dict[str, Missing]
    """By the name of the test. The same residuals may fail several tests: models that add nothing to others are not
    here."""
    places: dict[str, np.ndarray]
    """Positions of the terms of each model in `Missing`."""
    splits: dict[str, Split]
    """The cross-validations that the data allow, by the names of their tests."""


class _Seen(NamedTuple):
    """Directions of the terms in which the score says something."""

    root: np.ndarray
    """Independent directions [terms, seen], of unit variance."""
    parts: np.ndarray
    """The score along them, in standard deviations."""

    @property
    def statistic(self) -> float:
        """Chi-squared, with as many degrees of freedom as directions."""
        return float(np.sum(self.parts**2))

    @property
    def surprise(self) -> float:
        """About -2 log p, also where p is too small for numbers (Chernoff's bound)."""
        dof = max(len(self.parts), 1)
        ratio = max(self.statistic / dof, 1.0)
        return dof * (ratio - 1.0 - float(np.log(ratio)))


def judge(result: Adjustment, settings: CalibrationSettings) -> Judged:
    """Test the models of a finished solve; call in 64 bit.

    Args:
        result: Of `adjust`, converged.
        settings: Of the solve.
    """
    corner_noise, stripe_noise = result.corner_noise, result.stripe_noise_rms
    score = score_models(result.problem, result.linearised, extents_of(result.data))
    seen = {name: _look(score, name) for name in (*_ORDER, "radial") if name in score.places}
    tests = []
    for name in (name for name in _ORDER if name in seen):
        noise = stripe_noise if name == "sheet" else corner_noise
        statistic, dof = seen[name].statistic, len(seen[name].parts)
        if name == "axis" and not result.angle_sigma:
            # Less the part that a wrong angle at every stop would explain.
            statistic, dof = max(statistic - seen["table"].statistic, 0.0), dof - len(seen["table"].parts)
        test = _tested(name, statistic, dof, noise)
        if name == "lens":
            radial = _tested(name, seen["radial"].statistic, len(seen["radial"].parts), noise)
            # Of two tests of the same model the one that fails, if any; two chances of chance count.
            found, loser = (test, "radial") if test.p_structure <= radial.p_structure else (radial, "lens")
            del seen[loser]
            test = replace(found, p=min(1.0, 2.0 * found.p), p_structure=min(1.0, 2.0 * found.p_structure))
        if test.dof > 0 or name == "lens":
            tests.append(test)
    halves = compare_halves(result, settings, (1.0, 1.0))
    if halves is not None:
        given = halves
        if max(abs(corner_noise - 1.0), abs(stripe_noise - 1.0)) > _REPEATED:
            # With weights of the noise that the detector promised.
            given = compare_halves(result, settings, (corner_noise, result.stripe_point_noise)) or halves
        p, p_structure = chance_of(given.distance(), given.dof), chance_of(halves.distance(), halves.dof)
        tests.append(ModelTest("halves", given.distance(), given.dof, p, p_structure))
    regions = compare_regions(result, settings)
    if regions is not None and regions.dof:
        tests.append(_tested("regions", regions.distance(), regions.dof, corner_noise))
    splits = {name: split for name, split in (("halves", halves), ("regions", regions)) if split is not None}
    failed = {test.name for test in tests if result_of_test(test.p, test.p_structure, len(tests)) == "structure"}
    suspects = [name for name in seen if ("lens" if name == "radial" else name) in failed]
    return Judged(tuple(tests), _explain(score, suspects, len(tests)), score.places, splits)


def _tested(name: str, statistic: float, dof: int, noise: float) -> ModelTest:
    given = statistic * noise**2
    return ModelTest(name, given, dof, chance_of(given, dof), chance_of(statistic, dof))


def _look(score: Score, name: str, known: _Seen | None = None) -> _Seen:
    """The score of the terms of one model beside those that are known.

    The directions are independent of the known ones: from the terms of the model, those that would explain the same
    are taken off (Gram and Schmidt, with the score's variance as the product).
    """
    places = score.places[name]
    places = places[score.own[places] > 0]
    gradient, variance = score.gradient[places], score.variance[np.ix_(places, places)]
    alike = np.zeros((len(places), 0))
    if known is not None:
        alike = score.variance[places] @ known.root
        gradient, variance = gradient - alike @ known.parts, variance - alike @ alike.T
    unit = np.sqrt(score.own[places])
    values, vectors = np.linalg.eigh(variance / np.outer(unit, unit))
    kept = values > {"radial": _RADIAL_IMITATED, "table": _TURN_IMITATED}.get(name, _IMITATED)
    own = vectors[:, kept] / np.sqrt(values[kept]) / unit[:, None]
    root = np.zeros((len(score.own), own.shape[1]))
    root[places] = own
    if known is not None:
        root = root - known.root @ (alike.T @ own)
    return _Seen(root, own.T @ gradient)


def _explain(score: Score, suspects: Sequence[str], tests: int) -> dict[str, Missing]:
    """The terms that explain the structure: those of the likeliest model first, then those of the remainder."""
    known, left, found = _Seen(np.zeros((len(score.own), 0)), np.zeros(0)), list(suspects), {}
    while left:
        looks = {name: _look(score, name, known) for name in left}
        name = max(left, key=lambda name: looks[name].surprise)
        root, parts = looks[name]
        p = chance_of(looks[name].statistic, len(parts))
        if result_of_test(p, p, tests) != "structure":
            break
        left.remove(name)
        if name not in ("table", "axis"):
            # Directions that say no more than noise does would add its error, not the model's.
            parts = parts * np.maximum(1.0 - _CHANCE / np.maximum(parts**2, _CHANCE), 0.0)
        known = _Seen(np.concatenate([known.root, root], axis=1), np.concatenate([known.parts, parts]))
        size = root @ parts
        found["lens" if name == "radial" else name] = Missing(size, root, size @ score.taken)
    return found


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


def extents_of(data: Prepared) -> Extents:
    """Those of an image and of the stripes seen in it."""
    half = np.array(data.size) / 2.0
    points = data.stripe_q[data.stripe_valid] if data.stripe_valid.any() else np.zeros((1, 2))
    low, high = points.min(0), points.max(0)
    return Extents(np.stack([half - 0.5, half]), np.stack([(low + high) / 2, np.maximum((high - low) / 2, 1.0)]))


def lens_terms(q: Float[np.ndarray, "views corners 2"], extents: Extents) -> Float[np.ndarray, "views rows terms"]:
    """Displacements of the image that are polynomials of the place in it [px]."""
    where = (q - extents.image[0]) / extents.image[1]
    field = _polynomials(where, _LENS_DEGREE)
    along, across = np.stack([field, np.zeros_like(field)], 2), np.stack([np.zeros_like(field), field], 2)
    terms = np.concatenate([along, across], axis=-1)
    return terms.reshape(terms.shape[0], -1, terms.shape[-1])


def radial_terms(q: Float[np.ndarray, "views corners 2"], extents: Extents) -> Float[np.ndarray, "views rows terms"]:
    """Displacements from the centre of the image as the next powers of the distance from it [px]."""
    away = (q - extents.image[0]) / np.linalg.norm(extents.image[1])
    square = np.sum(away * away, axis=-1)[..., None]
    terms = np.stack([away * square**power for power in _RADIAL_POWERS], axis=-1)
    return terms.reshape(terms.shape[0], -1, terms.shape[-1])


def board_terms(problem: Problem, shift: Float[np.ndarray, "views rows 3"]) -> Float[np.ndarray, "views rows terms"]:
    """Shapes of the board: polynomial heights, and prints that are not true [px]."""
    where = (np.asarray(problem.board)[:, :2] - problem.frame[:2]) / problem.frame[2:]
    heights, prints = _polynomials(where, _HEIGHT_DEGREE), _polynomials(where, _PRINT_DEGREE)
    # A shift along the axes of the board moves a corner as it moves the whole board.
    rows = lambda values: np.repeat(values, 2, axis=0)[None]
    parts = [
        shift[..., 0:1] * rows(prints),
        shift[..., 1:2] * rows(prints),
        shift[..., 2:3] * rows(heights),
    ]
    return np.concatenate(parts, axis=-1)


def sheet_terms(
    q: Float[np.ndarray, "stripes points 2"], problem: Problem, extents: Extents
) -> Float[np.ndarray, "stripes points terms"]:
    """Displacements of the stripe of each laser that are polynomials of the place in the image [px]."""
    where = (q - extents.stripe[0]) / extents.stripe[1]
    # Along the stripe any shape, across it (near and far) little.
    long = int(np.argmax(extents.stripe[1]))
    first, second = where[..., long], where[..., 1 - long]
    along = np.stack([first**i for i in range(_SHEET_DEGREES[0] + 1)], -1)
    across = np.stack([second**i for i in range(_SHEET_DEGREES[1] + 1)], -1)
    field = (along[..., :, None] * across[..., None, :]).reshape(*first.shape, -1)
    lasers = len(problem.lasers.distance)
    own = np.asarray(problem.stripe_laser)[:, None, None, None] == np.arange(lasers)[None, None, :, None]
    return np.where(own, field[:, :, None, :], 0.0).reshape(*first.shape, -1)


def _polynomials(where: Float[np.ndarray, "... 2"], degree: int) -> Float[np.ndarray, "... terms"]:
    # Chebyshev's, which are less alike than powers.
    def chebyshev(x):
        values = [np.ones_like(x), x]
        for _ in range(degree - 1):
            values.append(2.0 * x * values[-1] - values[-2])
        return values

    x, y = chebyshev(where[..., 0]), chebyshev(where[..., 1])
    return np.stack([x[i] * y[j] for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)


def turn_terms(problem: Problem, views: Int[np.ndarray, " views"]) -> Float[np.ndarray, "views terms"]:
    """Errors of the motion's positions at some views [rad or m].

    One of each view's own where stops are exact. Where they err by chance, those that chance does not make.
    """
    if float(problem.stop_sigma) <= LEAST_STOP_SIGMA:
        return np.eye(len(views))
    faults, stop = faults_of_motion(problem), np.asarray(problem.stop)[views]
    return np.einsum("vs,vst->vt", stop, faults[np.asarray(problem.placement)[views]])


def moving_twist(pose: Float[np.ndarray, "... 4 4"], motion: AbstractMotion) -> Float[np.ndarray, "... 6"]:
    """Twist (translation, rotation) of a board, in its own axes, that a motion by 1 rad or 1 m gives it in the image.

    Args:
        pose: T_cam_board; the axis or direction is the same at all positions, seen from the camera.
        motion: Of the camera.
    """
    # The camera moves, so the board moves the other way.
    back = np.swapaxes(pose[..., :3, :3], -1, -2)
    speed, axis = np.split(np.asarray(motion.twist()), 2)
    shift = speed + np.cross(axis, pose[..., :3, 3])
    return -np.concatenate([(back @ shift[..., None])[..., 0], back @ axis], axis=-1)
