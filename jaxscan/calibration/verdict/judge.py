r"""Do the models of lens, board, table and sheet suffice? Tests of the residuals.

A score test (Rao) asks of every model whether terms that it does not have would be worth
having: with residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra
terms, all whitened, and $g = E^T r$,

$$T = g^T V^{-1} g, \qquad V = E^T E - E^T J (J^T J)^{-1} J^T E$$

is chi-squared with as many degrees of freedom as terms that the unknowns cannot imitate. Nothing
is solved again, and the failing model is named. A cross-validation, two halves of the records
solved apart, asks the same of all models together.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxscan.calibration.chi_squared import chance_of
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjustment import Adjustment
from jaxscan.calibration.verdict.extra_terms import extents_of
from jaxscan.calibration.verdict.halves import Halves, compare_halves
from jaxscan.calibration.verdict.limits import result_of_test
from jaxscan.calibration.verdict.quality import ModelTest
from jaxscan.calibration.verdict.score import Score, score_models


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
    """"lens", "board", "table" (its angles), "axis" (whether it stands still), "sheet" and "halves", those that the
    data allow."""
    missing: dict[str, Missing]
    """By the name of the test. The same residuals may fail several tests: models that add nothing to others are not
    here."""
    places: dict[str, np.ndarray]
    """Positions of the terms of each model in `Missing`."""
    halves: Halves | None


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
    failed = {test.name for test in tests if result_of_test(test.p, test.p_structure, len(tests)) == "structure"}
    suspects = [name for name in seen if ("lens" if name == "radial" else name) in failed]
    return Judged(tuple(tests), _explain(score, suspects, len(tests)), score.places, halves)


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
