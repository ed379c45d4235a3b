r"""Structure in the residuals: which model lacks something, and the error that this does to the rig.

A score test (Rao) asks of every model whether terms that it does not have would be worth having: with residuals $r$ at
the minimum, derivatives $J$ by the unknowns and $E$ by the extra terms, all whitened, and $g = E^T r$,

$$T = g^T V^{-1} g, \qquad V = E^T E - E^T J (J^T J)^{-1} J^T E$$

is chi-squared with as many degrees of freedom as terms that the unknowns cannot imitate. Nothing is solved again.

The harm is given as steps of the parameters, like standard deviations along independent directions: $\sum_k s_k s_k^T$
is added to their covariance. With the sizes $-m$ of the missing terms the shared unknowns are off by
$\delta = (J^T J)^{-1} J^T E m$ ("imitation"), and the missing shape itself remains beside it. Of lens and sheet the two
are added first, since they cancel in part; the shape that their parameters can follow becomes a step of these, and the
rest a step of those that act alike.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.adjust import Adjustment
from jaxscan.calibration.cross_validation import Split, compare_halves, compare_regions, put_back_lines
from jaxscan.calibration.problem import LEAST_STOP_SIGMA, Problem, corner_pixels, layout_of, move
from jaxscan.calibration.propagate import TRAVEL_M, ray_error
from jaxscan.calibration.result import ModelTest, result_of_test
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.stops import faults_of_motion
from jaxscan.geometry import AbstractMotion, LinearStage
from jaxscan.leastsq import Unknowns, chance_of
from jaxscan.observation import Observations


# Share of the terms of a model, in each direction, that the unknowns must not imitate. Less is as small as the second
# order of the projection, which is no noise; of the next powers of the radius little else remains, and stops that err
# by chance imitate a fault of the table but for the part that chance makes unlikely.
_IMITATED, _IMITATED_BY = 1e-2, {"radial": 1e-3, "table": 1e-6}
_ORDER = ("lens", "board", "paper", "table", "axis", "sheet")
# The halves are compared again, with the weights promised, where the noise differs from the promise by this share.
_REPEATED = 0.05
# Square of what noise alone gives a direction, at two standard deviations.
_CHANCE = 4.0
_LENS_DEGREE, _HEIGHT_DEGREE, _PRINT_DEGREE = 6, 4, 3
_RADIAL_POWERS = (4, 5)
# Of the sheet along the stripe, and across it.
_SHEET_DEGREES = (5, 1)
# Zones of the image by the place in it, -1 ... 1: corners where both coordinates are beyond this, edges where one is,
# and the middle within half of it. A zone is named where its error is this many times that of the whole image.
_OUTER, _STANDS_OUT = 0.6, 1.3


class Harm(NamedTuple):
    """A test, and the error that the structure it found does."""

    test: ModelTest
    steps: Float[np.ndarray, "steps shared"]
    """In px, rad, m: at most one for each parameter of the rig; none without structure."""


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


class _Seen(NamedTuple):
    """Directions of the terms in which the score says something."""

    root: Float[np.ndarray, "terms seen"]
    """Independent directions of unit variance."""
    parts: Float[np.ndarray, " seen"]
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


class _Missing(NamedTuple):
    """Terms that a model lacks, as far as the residuals show them, and their changes of terms found before."""

    size: Float[np.ndarray, " terms"]
    """The residuals ask for `-size` of each term; less the part that noise alone would give, but of single views."""
    noise: Float[np.ndarray, "terms seen"]
    """Root of the covariance of `size` as noise causes it."""
    imitation: Float[np.ndarray, " shared"]
    """How far the shared unknowns would go, to first order, if the model had these terms [px, rad, m]."""


def find_harm(result: Adjustment, settings: CalibrationSettings, given: Observations) -> list[Harm]:
    """Test the models of a finished solve, and find the error that the structure in its residuals does.

    Returns:
        The tests that the data allow: "lens", "board", "paper" (whether the board bends from placement to placement),
        "table" (its angles), "axis" (whether it stands still), "sheet", then the cross-validations "halves", "regions"
        and "lines", which count for the part that others do not cover.
        The same residuals may fail several tests: a model that adds nothing to others does no harm.
    """
    score, scales = score_models(result), np.asarray(result.problem.scales)
    looks = {name: _look(score, name) for name in (*_ORDER, "radial") if name in score.places}
    looks["paper"] = _look_at_paper(score)
    tests, splits = _score_tests(result, looks), _cross_validations(result, settings)
    count = len(tests) + len(splits)
    fails = lambda test: result_of_test(test.p, test.p_structure, count) == "structure"
    failed = {test.name for test in tests if fails(test)}
    suspects = [name for name in looks if ("lens" if name == "radial" else name) in failed]
    missing, found = _explain(score, suspects, looks["paper"], count, scales), list[Harm]()
    none = np.zeros((0, len(scales)))
    for test in tests:
        steps, where = _steps_of(result, score, missing[test.name]) if test.name in missing else (none, None)
        bend_mm = _bend_mm(result.problem, score, missing["paper"]) if test.name == "paper" and len(steps) else None
        found.append(Harm(replace(test, where=where, bend_mm=bend_mm), steps))
    for test, split in splits:
        before = np.concatenate([none, *(harm.steps for harm in found)])
        # Boards that bend do more harm to a part of the records than to all: it says nothing about the whole.
        beyond = fails(test) and "paper" not in missing
        steps = split.beyond(before.T @ before, scales)[None] if beyond else none
        counts = test.name != "regions" or not len(steps) or beyond_noise(result, split, steps)
        found.append(Harm(test, steps if counts else none))
    lines = put_back_lines(result, given) if len(result.problem.lasers.distance) else []
    return [*found, Harm(_lines_test(result, lines), np.stack(lines))] if lines else found


def _score_tests(result: Adjustment, looks: dict[str, _Seen]) -> list[ModelTest]:
    """The tests; of "lens" and "radial" the one is taken out of `looks` that finds less."""
    tests = []
    for name in (name for name in _ORDER if name in looks):
        noise = result.stripe_noise_rms if name == "sheet" else result.corner_noise
        statistic, dof = looks[name].statistic, len(looks[name].parts)
        if name == "axis" and not result.angle_sigma:
            # Less the part that a wrong angle at every stop would explain.
            statistic, dof = max(statistic - looks["table"].statistic, 0.0), dof - len(looks["table"].parts)
        test = _tested(name, statistic, dof, noise)
        if name == "lens":
            radial = _tested(name, looks["radial"].statistic, len(looks["radial"].parts), noise)
            # Of two tests of the same model the one that fails, if any; two chances of chance count.
            found, loser = (test, "radial") if test.p_structure <= radial.p_structure else (radial, "lens")
            del looks[loser]
            test = replace(found, p=min(1.0, 2.0 * found.p), p_structure=min(1.0, 2.0 * found.p_structure))
        if test.dof > 0 or name == "lens":
            tests.append(test)
    return tests


def _cross_validations(result: Adjustment, settings: CalibrationSettings) -> list[tuple[ModelTest, Split]]:
    """Those that the data allow."""
    found, noise = [], (result.corner_noise, result.stripe_noise_rms)
    halves, regions = compare_halves(result, settings, (1.0, 1.0)), compare_regions(result, settings)
    if halves is not None:
        given = halves
        if max(abs(ratio - 1.0) for ratio in noise) > _REPEATED:
            # With weights of the noise that the detector promised.
            given = compare_halves(result, settings, (noise[0], result.stripe_point_noise)) or halves
        p, p_structure = (chance_of(split.distance(), split.dof) for split in (given, halves))
        found.append((ModelTest("halves", given.distance(), given.dof, p, p_structure), halves))
    if regions is not None and regions.dof:
        found.append((_tested("regions", regions.distance(), regions.dof, noise[0]), regions))
    return found


def beyond_noise(result: Adjustment, split: Split, step: np.ndarray) -> bool:
    """Whether a step [1, shared] does more to rays over the image than noise does to them in such a difference.

    A lens of many coefficients, known in the middle of the image alone, is lost at its rim by noise.
    """
    own, (width, height) = layout_of(result.problem).camera, result.data.size
    camera = replace(result.problem.camera, width=width, height=height)
    noise = split.noise(np.asarray(result.problem.scales))
    return ray_error(camera, step[:, own]) > ray_error(camera, noise[:, own])


def _tested(name: str, statistic: float, dof: int, noise: float) -> ModelTest:
    given = statistic * noise**2
    return ModelTest(name, given, dof, chance_of(given, dof), chance_of(statistic, dof))


def _lines_test(result: Adjustment, steps: list[np.ndarray]) -> ModelTest:
    """The steps of sheets by lines that were left out, against the covariance of noise."""
    scales = np.asarray(result.problem.scales)
    moved = np.array([step != 0 for step in steps]).any(0)
    step = np.sum(steps, axis=0)[moved] / scales[moved]
    covariance = np.linalg.inv(result.linearised.reduced)[np.ix_(moved, moved)]
    return _tested("lines", float(step @ np.linalg.solve(covariance, step)), int(moved.sum()), 1.0)


def _look(score: Score, name: str, known: _Seen | None = None) -> _Seen:
    """The score of the terms of one model beside those that are known."""
    places = score.places[name]
    places = places[score.own[places] > 0]
    gradient, variance = score.gradient[places], score.variance[np.ix_(places, places)]
    alike = np.zeros((len(places), 0))
    if known is not None:
        alike = score.variance[places] @ known.root
        gradient, variance = gradient - alike @ known.parts, variance - alike @ alike.T
    unit = np.sqrt(score.own[places])
    values, vectors = np.linalg.eigh(variance / np.outer(unit, unit))
    kept = values > _IMITATED_BY.get(name, _IMITATED)
    own = vectors[:, kept] / np.sqrt(values[kept]) / unit[:, None]
    root = np.zeros((len(score.own), own.shape[1]))
    root[places] = own
    if known is not None:
        root = root - known.root @ (alike.T @ own)
    return _Seen(root, own.T @ gradient)


def _look_at_paper(score: Score) -> _Seen:
    """The score of boards that bend, beside all that lens, board and sheet could lack: what differs between boards."""
    known = _nothing_seen(score)
    for name in ("lens", "board", "sheet"):
        if name in score.places:
            known = _joined(known, _look(score, name, known))
    return _look(score, "paper", known)


def _nothing_seen(score: Score) -> _Seen:
    return _Seen(np.zeros((len(score.own), 0)), np.zeros(0))


def _joined(one: _Seen, other: _Seen) -> _Seen:
    return _Seen(np.concatenate([one.root, other.root], axis=1), np.concatenate([one.parts, other.parts]))


def _explain(
    score: Score, suspects: Sequence[str], paper: _Seen, tests: int, scales: np.ndarray
) -> dict[str, _Missing]:
    """The terms that explain the structure, by test: those of the likeliest model, then those of the remainder.

    Boards that bend imitate much else, so they are the likeliest by what no other model explains, or are none.
    """
    known, left, found = _nothing_seen(score), list(suspects), dict[str, _Missing]()
    while left:
        looks = {name: _look(score, name, known) for name in left}
        name = max(left, key=lambda name: (paper if name == "paper" else looks[name]).surprise)
        root, parts = looks[name]
        p = chance_of(looks[name].statistic, len(parts))
        if result_of_test(p, p, tests) != "structure":
            break
        left = [other for other in left if other not in (name, "paper")]
        if name not in ("table", "axis"):
            # Directions that say no more than noise does would add its error, not the model's.
            parts = parts * np.maximum(1.0 - _CHANCE / np.maximum(parts**2, _CHANCE), 0.0)
        known = _joined(known, _Seen(root, parts))
        size = root @ parts
        found["lens" if name == "radial" else name] = _Missing(size, root, size @ score.taken * scales)
    return found


def score_models(result: Adjustment) -> Score:
    """Score of every model at the minimum of a solve.

    Terms of "axis", and of "table" where stops are exact, are those of single views, of `repeated_views`; those of
    "paper" are of single placements.
    """
    problem, linear, (width, height) = result.problem, result.linearised, result.data.size
    half, views = np.array([width, height]) / 2.0, repeated_views(problem)
    weight = np.repeat(np.asarray(problem.corner_weight), 2, axis=1)
    camera = len(problem.camera.parameter_names())
    twist = linear.corner_slopes[..., camera : camera + 6]
    shapes = _lens_terms((_seen_corners(result) - (half - 0.5)) / half, half)
    # Displacements of the image are weighted here, those of the board were when the rows were formed.
    corner = {name: terms * weight[..., None] for name, terms in shapes.items()}
    corner["board"] = _board_terms(problem, twist[..., :3])
    # The mean of the residuals is one more term, of known size, that the unknowns imitate in part.
    corner["bend"] = (_mean_residual(result) * weight)[..., None]
    # Terms that each view or placement has for itself.
    used = np.any(weight > 0, axis=1)
    of_board = np.unique(np.asarray(problem.placement)[used])
    of_view, of_placement = _numbers(views, len(used)), _numbers(of_board, len(problem.poses))
    bent = twist[..., 2, None] * np.repeat(_bends(problem, np.asarray(problem.board)[:, :2]), 2, axis=0)
    single = {"paper": _Single(bent, of_placement[np.asarray(problem.placement)])}
    # An axis that is held may have no views that show it.
    if problem.turntable.blocks and len(views):
        shapes["table"] = _turn_terms(problem, views)
        turned = np.einsum("vrd,vd->vr", twist, moving_twist(linear.view_poses, problem.turntable))[..., None]
        if shapes["table"].shape[1] == len(views):
            single["table"] = _Single(turned, of_view)
        else:
            corner["table"] = np.zeros((*turned.shape[:2], shapes["table"].shape[1]))
            corner["table"][views] = turned[views] * shapes["table"][:, None]
        single["axis"] = _Single(twist, of_view)
    residual = linear.corner_error * weight
    groups = [(corner, single, linear.corner_slopes, linear.chains.corner, problem.placement, residual)]
    if len(problem.lasers.distance):
        shapes["sheet"], weight = _sheet_terms(result), np.asarray(problem.stripe_weight)
        sheet = {"sheet": shapes["sheet"] * (linear.slope * weight)[..., None]}
        owner, twist = problem.stripe_placement(), linear.stripe_slopes[..., camera : camera + 6]
        # A turn about x lifts a point by its y, one about y lowers it by its x.
        rise = np.where(weight > 0, twist[..., 2], 1.0)
        bent = rise[..., None] * _bends(problem, np.stack([-twist[..., 4], twist[..., 3]], -1) / rise[..., None])
        own = {"paper": _Single(np.where(weight[..., None] > 0, bent, 0.0), of_placement[np.asarray(owner)])}
        groups.append((sheet, own, linear.stripe_slopes, linear.chains.stripe, owner, linear.offset * weight))
    sizes = {name: terms.shape[-1] for terms_of, *_ in groups for name, terms in terms_of.items()}
    sizes |= {name: (int(of.max()) + 1) * terms.shape[-1] for name, (terms, of) in single.items()}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    places = {name: np.arange(*part) for name, *part in zip(sizes, ends[:-1], ends[1:], strict=True)}
    count, shared = ends[-1], len(problem.scales)
    gradient, gram, met = np.zeros(count), np.zeros((count, count)), np.zeros((count, shared))
    met_by = np.zeros((len(problem.poses), count, problem.own))
    for terms_of, alone, slopes, chain, block, residual in groups:
        common = np.concatenate([places[name] for name in terms_of])
        every = np.concatenate(list(terms_of.values()), axis=-1)
        for number in np.flatnonzero(np.any(residual, axis=1)).tolist():
            terms, columns = every[number], common
            for name, (values, of) in alone.items():
                if of[number] >= 0:
                    terms = np.concatenate([terms, values[number]], axis=1)
                    own = places[name].reshape(-1, values.shape[-1])[of[number]]
                    columns = np.concatenate([columns, own])
            gradient[columns] += terms.T @ residual[number]
            gram[np.ix_(columns, columns)] += terms.T @ terms
            times = terms.T @ slopes[number] @ chain[number]
            met[columns] += times[:, :shared]
            met_by[block[number], columns] += times[:, shared:]
    # Poses and stops are eliminated, then the shared unknowns.
    known = linear.covariance
    side = np.moveaxis(met_by, 1, 0).reshape(count, -1)
    followed = np.moveaxis(met_by @ known.alone, 1, 0).reshape(count, -1)
    left = met - side @ known.coupling.reshape(-1, shared)
    taken = left @ known.shared
    variance = gram - followed @ side.T - taken @ left.T
    (bend,) = places.pop("bend")
    for name in ("lens", "radial", "board"):
        gradient[places[name]] -= variance[places[name], bend]
    return Score(gradient, np.diag(gram).copy(), variance, taken, places, shapes)


class _Single(NamedTuple):
    """Terms that every view or placement has for itself."""

    terms: Float[np.ndarray, "owners rows terms"]
    of: Int[np.ndarray, " owners"]
    """The number of each owner's terms, -1 for none."""


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


def _seen_corners(result: Adjustment) -> Float[np.ndarray, "views corners 2"]:
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


def _bends(problem: Problem, xy: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 3"]:
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


def _steps_of(result: Adjustment, score: Score, missing: _Missing) -> tuple[np.ndarray, str | None]:
    """The steps of missing terms, and where in the image they tell most."""
    steps, where, imitation = [missing.imitation], None, missing.imitation
    has = {name: name in score.places and np.any(missing.size[score.places[name]] != 0) for name in _HARMFUL}
    shape = lambda name: score.shapes[name] @ missing.size[score.places[name]]
    if has["lens"] or has["radial"]:
        rest, where = _of_lens(result, shape("lens") + shape("radial"), imitation)
        steps += rest
    if has["sheet"]:
        steps += _of_sheets(result, shape("sheet"), imitation)
    if has["table"] or has["axis"]:
        steps += _of_motion(result, score, missing)
    return np.stack(steps), where


_HARMFUL = ("lens", "radial", "sheet", "table", "axis")


def _of_lens(result: Adjustment, shape: np.ndarray, imitation: np.ndarray) -> tuple[list[np.ndarray], str | None]:
    """Steps of a lens that lacks a shape [views, rows], px; the imitation is changed to the part it can follow."""
    camera, names = layout_of(result.problem).camera, layout_of(result.problem).names
    weight = np.repeat(np.asarray(result.problem.corner_weight), 2, axis=1)
    used = weight > 0
    by_camera = result.linearised.corner_slopes[used][:, camera] / weight[used][:, None]
    # The rays of the fitted camera are off by this much [px], rows u and v in turn.
    field = by_camera @ imitation[camera] - shape[used]
    free = np.asarray(result.problem.scales)[camera]
    imitation[camera] = np.linalg.lstsq(by_camera * free, field, rcond=1e-9)[0] * free
    rest, steps = (field - by_camera @ imitation[camera]).reshape(-1, 2), []
    for axis, (focal, centre) in enumerate((("fx", "cx"), ("fy", "cy"))):
        size, reach = (np.sqrt(np.mean(np.square(values))) for values in (rest[:, axis], by_camera[axis::2, axis]))
        # A turn of the camera takes up what moves its centre, so the focal length has all of it and the centre half.
        steps += [_one(names, focal, size / reach), _one(names, centre, np.sqrt(0.5) * size)]
    half = np.array(result.data.size) / 2.0
    return steps, _zone((_seen_corners(result)[used[:, ::2]] - (half - 0.5)) / half, field.reshape(-1, 2))


def _bend_mm(problem: Problem, score: Score, missing: _Missing) -> float:
    """Root mean square height by which the board differs from placement to placement, less the part of noise [mm]."""
    own, board = score.places["paper"], np.asarray(problem.board)[:, :2]
    heights, plane = _bends(problem, board), np.column_stack([np.ones(len(board)), board])
    heights = heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]
    shapes, chance = missing.size[own].reshape(-1, 3), missing.noise[own].reshape(-1, 3, missing.noise.shape[1])
    square = np.mean(((shapes - shapes.mean(0)) @ heights.T) ** 2)
    by_chance = np.mean(np.sum((heights @ chance) ** 2, axis=-1))
    return 1e3 * float(np.sqrt(max(square - by_chance, 0.0)))


def _zone(place: np.ndarray, field: np.ndarray) -> str | None:
    """Where in the image a field is largest, what looks like a turn of the camera (about a shift) taken off."""
    error = np.sum(np.square(field - field.mean(0)), axis=1)
    outer = np.abs(place) > _OUTER
    zones = {
        "in the corners": outer.all(1),
        "at the edges": outer.any(1) & ~outer.all(1),
        "in the middle": np.linalg.norm(place, axis=1) < _OUTER / 2.0,
    }
    sizes = {name: np.sqrt(np.mean(error[inside])) for name, inside in zones.items() if inside.any()}
    name = max(sizes, key=lambda name: sizes[name]) if sizes else None
    return name if name is not None and sizes[name] > _STANDS_OUT * np.sqrt(np.mean(error)) else None


def _of_sheets(result: Adjustment, shape: np.ndarray, imitation: np.ndarray) -> list[np.ndarray]:
    """Steps of sheets that lack a shape [stripes, points], px; the imitation is changed to the part it can follow."""
    problem, linear, first, turns = result.problem, result.linearised, layout_of(result.problem).lasers.start, []
    # How far the points of the sheet are from their plane [m] beside the imitation.
    weight, bend = np.asarray(problem.stripe_weight), -linear.slope * shape
    parts = linear.stripe_slopes / np.where(weight > 0, weight, 1.0)[..., None]
    for laser in range(len(problem.lasers.distance)):
        lit = (weight > 0) & (np.asarray(problem.stripe_laser) == laser)[:, None]
        if not lit.any():
            continue
        # The derivative by the normal is the point itself.
        points, basis = parts[lit][:, -6:-3], np.asarray(problem.lasers.basis)[laser]
        own = slice(first + 5 * laser, first + 5 * (laser + 1))
        by_sheet = np.concatenate([points @ basis.T, parts[lit][:, -3:]], axis=1)
        free = np.asarray(problem.scales)[own]
        followed = np.linalg.lstsq(by_sheet * free, bend[lit], rcond=1e-9)[0] * free
        rest = (bend[lit] - by_sheet @ followed) / np.linalg.norm(points, axis=1)
        imitation[own] += followed
        # A turn about the line across the rays moves all points of the sheet alike, for their distance.
        ahead = points.mean(0) / np.linalg.norm(points.mean(0))
        turns.append(np.zeros_like(imitation))
        turns[-1][own.start : own.start + 2] = basis @ ahead * np.sqrt(np.mean(np.square(rest)))
    return turns


def _of_motion(result: Adjustment, score: Score, missing: _Missing) -> list[np.ndarray]:
    """Steps of a motion that does not go where its model says: along it, and any other way."""
    problem, names = result.problem, layout_of(result.problem).names
    along, chance = (score.shapes["table"] @ part[score.places["table"]] for part in (missing.size, missing.noise))
    error = np.sqrt(max(np.mean(along**2) - np.mean(np.sum(chance**2, axis=1)), 0.0))
    # Of each board's middle across its line of sight and across the motion.
    views = repeated_views(problem)
    pose, middle = result.linearised.view_poses[views], np.append(np.asarray(problem.frame)[:2], 0.0)
    turn, point = pose[:, :3, :3], pose[:, :3, :3] @ middle + pose[:, :3, 3]
    # It moves by a twist in the board's own axes: v + w x middle.
    moved = np.concatenate([turn, turn @ np.cross(np.eye(3), middle).T], axis=2)
    speed, axis = np.split(np.asarray(problem.turntable.twist()), 2)
    for direction in (speed + np.cross(axis, point), point):
        unit = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
        moved = moved - unit[:, :, None] * np.einsum("vi,vij->vj", unit, moved)[:, None, :]
    aside, by_chance = (
        np.sum((moved @ part[score.places["axis"]].reshape(len(views), 6, -1)) ** 2)
        for part in (missing.size, missing.noise)
    )
    shift = np.sqrt(max(aside - by_chance, 0.0) / len(views))
    if isinstance(problem.turntable, LinearStage):
        # Errors of places count over a usual travel.
        sizes = {"gain": error / TRAVEL_M, "travel.t1": shift / TRAVEL_M, "travel.t2": shift / TRAVEL_M}
    else:
        tilt = shift / np.sqrt(np.mean(np.sum(point**2, axis=1)))
        sizes = {"c1": error, "s1": error, "axis.d1": tilt, "axis.d2": tilt}
    return [_one(names, name, float(size)) for name, size in sizes.items()]


def _one(names: Sequence[str], name: str, size: float) -> np.ndarray:
    """A step of one parameter."""
    return size * (np.array(names) == name)
