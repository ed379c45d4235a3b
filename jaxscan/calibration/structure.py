r"""Structure in the residuals: which model lacks something, and what error this causes in the rig.

The score test (`score`) finds for every model whether it lacks something. The harm is given as steps of the parameters,
like standard deviations along independent directions: $\sum_k s_k s_k^T$ is added to their covariance. With the sizes
$-m$ of the missing terms the shared unknowns are off by $\delta = (J^T J)^{-1} J^T E m$ ("imitation"), and the missing
shape itself remains beside it. For lens and sheet the two are added first, since they cancel in part; the shape that
their parameters can follow becomes a step of these, and the rest a step of those that act alike.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.adjust import Adjustment
from jaxscan.calibration.cross_validation import Split, compare_halves, compare_regions, put_back_lines
from jaxscan.calibration.problem import Problem, layout_of
from jaxscan.calibration.propagate import TRAVEL_M, ray_error
from jaxscan.calibration.result import ModelTest, result_of_test
from jaxscan.calibration.score import Score, bends, repeated_views, score_models, seen_corners
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.geometry import LinearStage
from jaxscan.leastsq import chance_of
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
# Zones of the image by the place in it, -1 ... 1: corners where both coordinates are beyond this, edges where one is,
# and the middle within half of it. A zone is named where its error is this many times that of the whole image.
_OUTER, _STANDS_OUT = 0.6, 1.3


class Harm(NamedTuple):
    """A test, and the error that the structure it found does."""

    test: ModelTest
    steps: Float[np.ndarray, "steps shared"]
    """Steps in px, rad, m: at most one for each parameter of the rig; none without structure."""


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
            # Two tests have the same model; the one that fails counts, if any. Chance had two tries, so p is doubled.
            found, loser = (test, "radial") if test.p_structure <= radial.p_structure else (radial, "lens")
            del looks[loser]
            test = replace(found, p=min(1.0, 2.0 * found.p), p_structure=min(1.0, 2.0 * found.p_structure))
        if test.dof > 0 or name == "lens":
            tests.append(test)
    return tests


def _cross_validations(result: Adjustment, settings: CalibrationSettings) -> list[tuple[ModelTest, Split]]:
    """The cross-validations that the data allow."""
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
    return steps, _zone((seen_corners(result)[used[:, ::2]] - (half - 0.5)) / half, field.reshape(-1, 2))


def _bend_mm(problem: Problem, score: Score, missing: _Missing) -> float:
    """Root mean square height by which the board differs from placement to placement, less the part of noise [mm]."""
    own, board = score.places["paper"], np.asarray(problem.board)[:, :2]
    heights, plane = bends(problem, board), np.column_stack([np.ones(len(board)), board])
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
    # Errors of each board's middle, across its line of sight and across the motion.
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
