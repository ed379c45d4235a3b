r"""Do the models of lens, board, table and sheet suffice? Tests of what is left in the residuals.

A score test (Rao) asks of every model whether terms that it does not have would be worth
having: with residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra
terms, all whitened, and $g = E^T r$,

$$T = g^T V^{-1} g, \qquad V = E^T E - E^T J (J^T J)^{-1} J^T E$$

is chi-squared with as many degrees of freedom as terms that the unknowns cannot imitate. Nothing
is solved again, and the failing model is named. A cross-validation, two halves of the records
solved apart, asks the same of all models together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjust import Adjustment
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import Problem
from jaxscan.calibration.verdict.extra_terms import extents_of
from jaxscan.calibration.verdict.halves import compare_halves
from jaxscan.calibration.verdict.score import Score, score_models


# Directions in which the unknowns imitate the extra terms but for this share are left out: what
# remains of them is as small as the second order of the projection, which is no noise. Of the next
# powers of the radius little else remains, and only their mean by second order is taken off.
_IMITATED = 1e-2
_RADIAL_IMITATED = 1e-3
_ORDER = ("lens", "board", "table", "axis", "sheet")
_REPEATED = 0.05


class ModelTest(NamedTuple):
    """Whether one model leaves structure in the residuals."""

    name: str
    statistic: float
    """With the detector's sigmas."""
    dof: int
    p: float
    """Probability of more by chance, if the detector's sigmas are right."""
    p_structure: float
    """The same, with the noise that was estimated: structure alone."""
    shift: np.ndarray | None = None
    """How far the shared unknowns would go [scaled units], to first order, if the model had the
    terms that it lacks; None where the test does not know."""


ACCEPTED_P = 0.01
"""Chance of refusing good data, all tests together."""


def chance(p: Sequence[float]) -> float:
    """Probability that chance alone gives one of several tests a p as small as the smallest (Bonferroni's bound)."""
    return min(1.0, len(p) * min(p)) if p else 1.0


def judge(result: Adjustment, data: Prepared, settings: CalibrationSettings) -> list[ModelTest]:
    """Test the models of a finished solve; call in 64 bit.

    Args:
        result: Of `adjust`.
        data: What was solved from.
        settings: Of the solve.

    Returns:
        Tests "lens", "board", "table" (its angles), "axis" (whether it stands still), "sheet" and
        "halves", those that the data allow.
    """
    corner_noise, stripe_noise = result.corner_noise, result.stripe_noise
    problem = result.problem
    scores = score_models(problem, result.linearised, extents_of(data))
    noise = {**dict.fromkeys(_ORDER, corner_noise), "sheet": stripe_noise}
    tests = []
    repeated = _repeated_views(problem, result.view_keep & data.usable)
    angle_statistic, angle_dof = 0.0, 0
    for name in (name for name in _ORDER if name in scores):
        score = scores[name]
        if name in ("table", "axis"):
            score = score.only(np.repeat(repeated, len(score.gradient) // len(repeated)))
        statistic, dof, shift = _statistic(score)
        if name == "lens":
            radial = _statistic(scores["radial"], _RADIAL_IMITATED)
            whole = _tested(name, statistic, dof, shift, noise)
            tests.append(_likelier_failure(whole, _tested(name, *radial, noise)))
            continue
        if name == "table":
            angle_statistic, angle_dof = statistic, dof
        if name == "axis":
            # Beyond what a wrong angle at every stop would explain.
            statistic, dof = max(statistic - angle_statistic, 0.0), dof - angle_dof
        if dof > 0:
            tests.append(_tested(name, statistic, dof, shift, noise))
    halves = compare_halves(result, data, settings, (1.0, 1.0))
    if halves is not None:
        given = halves
        if max(abs(corner_noise - 1.0), abs(stripe_noise - 1.0)) > _REPEATED:
            # Weights that promise what the detector promised.
            given = compare_halves(result, data, settings, (corner_noise, stripe_noise)) or halves
        tests.append(ModelTest("halves", given[0], given[1], _p_value(*given), _p_value(*halves)))
    return tests


def _tested(name: str, statistic: float, dof: int, shift: np.ndarray, noise: dict[str, float]) -> ModelTest:
    given = statistic * noise[name] ** 2
    return ModelTest(name, given, dof, _p_value(given, dof), _p_value(statistic, dof), shift)


def _likelier_failure(one: ModelTest, other: ModelTest) -> ModelTest:
    """Of two tests of the same model the one that fails, if any; two chances of chance count."""
    worse = one if one.p_structure <= other.p_structure else other
    return worse._replace(p=min(1.0, 2.0 * worse.p), p_structure=min(1.0, 2.0 * worse.p_structure))


def _p_value(statistic: float, dof: int) -> float:
    if dof == 0:
        return 1.0
    return float(jax.scipy.special.gammaincc(0.5 * dof, 0.5 * max(statistic, 0.0)))


def _statistic(score: Score, imitated: float = _IMITATED) -> tuple[float, int, np.ndarray]:
    """The score's chi-squared, its degrees of freedom, and how far the unknowns would go with the terms."""
    score = score.only(np.asarray(score.own) > 0)
    if not len(score.own):
        return 0.0, 0, np.zeros(score.taken.shape[1])
    size = np.sqrt(score.own)
    values, vectors = np.linalg.eigh(score.variance / np.outer(size, size))
    seen = values > imitated
    parts = (vectors.T @ (score.gradient / size))[seen]
    missing = (vectors[:, seen] @ (parts / values[seen])) / size
    return float(np.sum(parts**2 / values[seen])), int(seen.sum()), missing @ score.taken


def _repeated_views(problem: Problem, used: np.ndarray) -> np.ndarray:
    """Views of placements that were seen from several angles: only there can a turn be wrong."""
    placement = np.asarray(problem.placement)
    count = np.bincount(placement[used], minlength=len(placement))
    return used & (count[placement] > 1)
