r"""Do the models of lens, board, table and sheet suffice? Tests of the residuals.

A score test (Rao) asks of every model whether terms that it does not have would be worth
having: with residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra
terms, all whitened, and $g = E^T r$,

$$T = g^T V^{-1} g, \qquad V = E^T E - E^T J (J^T J)^{-1} J^T E$$

is chi-squared with as many degrees of freedom as terms that the unknowns cannot imitate. Nothing
is solved again, and the failing model is named. A cross-validation, two halves of the records
solved apart, asks the same of all models together.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjust import Adjustment
from jaxscan.calibration.solve.problem import Problem
from jaxscan.calibration.verdict.extra_terms import extents_of
from jaxscan.calibration.verdict.halves import Halves, compare_halves
from jaxscan.calibration.verdict.quality import ModelTest
from jaxscan.calibration.verdict.score import Score, score_models


# Directions in which the unknowns imitate the extra terms but for this share are left out: their
# remainder is as small as the second order of the projection, which is no noise. Of the next
# powers of the radius little else remains, and only their mean by second order is taken off.
_IMITATED = 1e-2
_RADIAL_IMITATED = 1e-3
_ORDER = ("lens", "board", "table", "axis", "sheet")
_REPEATED = 0.05
# Square of what noise alone gives a direction, at two standard deviations.
_CHANCE = 4.0


class Missing(NamedTuple):
    """Terms that a model lacks, as far as the residuals show them: the residuals ask for `-size` of each."""

    size: np.ndarray
    """Of every term; less the part that noise alone would give where `shrunk`."""
    noise: np.ndarray
    """Root of the covariance of `size` before it was shrunk [terms, seen]."""
    shift: np.ndarray
    """How far the shared unknowns would go [scaled units], to first order, if the model had these terms."""


class Finding(NamedTuple):
    """A test, and the terms or the difference that it found."""

    test: ModelTest
    missing: Missing | None = None
    radial: bool = False
    """Whether the terms of the lens are the next powers of the radius, rather than polynomials."""
    halves: Halves | None = None


def judge(result: Adjustment, settings: CalibrationSettings) -> list[Finding]:
    """Test the models of a finished solve; call in 64 bit.

    Args:
        result: Of `adjust`, converged.
        settings: Of the solve.

    Returns:
        Tests "lens", "board", "table" (its angles), "axis" (whether it stands still), "sheet" and
        "halves", those that the data allow.
    """
    corner_noise, stripe_noise = result.corner_noise, result.stripe_noise
    problem = result.problem
    scores = score_models(problem, result.linearised, extents_of(result.data))
    noise = {**dict.fromkeys(_ORDER, corner_noise), "sheet": stripe_noise}
    findings = []
    repeated = repeated_views(problem, result.view_kept & result.data.usable)
    angle_statistic, angle_dof = 0.0, 0
    for name in (name for name in _ORDER if name in scores):
        score = scores[name]
        if name in ("table", "axis"):
            score = score.only(np.repeat(repeated, len(score.gradient) // len(repeated)))
        statistic, dof, missing = _statistic(score, shrunk=name not in ("table", "axis"))
        if name == "lens":
            radial = _statistic(scores["radial"], _RADIAL_IMITATED)
            whole = _tested(name, statistic, dof, missing, noise)
            findings.append(_likelier_failure(whole, _tested(name, *radial, noise)._replace(radial=True)))
            continue
        if name == "table":
            angle_statistic, angle_dof = statistic, dof
        if name == "axis":
            # Less the part that a wrong angle at every stop would explain.
            statistic, dof = max(statistic - angle_statistic, 0.0), dof - angle_dof
        if dof > 0:
            findings.append(_tested(name, statistic, dof, missing, noise))
    halves = compare_halves(result, settings, (1.0, 1.0))
    if halves is not None:
        given = halves
        if max(abs(corner_noise - 1.0), abs(stripe_noise - 1.0)) > _REPEATED:
            # With weights of the noise that the detector promised.
            given = compare_halves(result, settings, (corner_noise, stripe_noise)) or halves
        p, p_structure = _p_value(given.distance(), given.dof), _p_value(halves.distance(), halves.dof)
        findings.append(Finding(ModelTest("halves", given.distance(), given.dof, p, p_structure), halves=halves))
    return findings


def repeated_views(problem: Problem, used: np.ndarray) -> np.ndarray:
    """Views of placements that were seen from several angles: only there can a turn be wrong."""
    placement = np.asarray(problem.placement)
    count = np.bincount(placement[used], minlength=len(placement))
    return used & (count[placement] > 1)


def _tested(name: str, statistic: float, dof: int, missing: Missing, noise: dict[str, float]) -> Finding:
    given = statistic * noise[name] ** 2
    return Finding(ModelTest(name, given, dof, _p_value(given, dof), _p_value(statistic, dof)), missing)


def _likelier_failure(one: Finding, other: Finding) -> Finding:
    """Of two tests of the same model the one that fails, if any; two chances of chance count."""
    found = one if one.test.p_structure <= other.test.p_structure else other
    test = found.test
    doubled = replace(test, p=min(1.0, 2.0 * test.p), p_structure=min(1.0, 2.0 * test.p_structure))
    return found._replace(test=doubled)


def _p_value(statistic: float, dof: int) -> float:
    if dof == 0:
        return 1.0
    return float(jax.scipy.special.gammaincc(0.5 * dof, 0.5 * max(statistic, 0.0)))


def _statistic(score: Score, imitated: float = _IMITATED, *, shrunk: bool = True) -> tuple[float, int, Missing]:
    """The score's chi-squared, its degrees of freedom, and the terms that it asks for."""
    known = np.asarray(score.own) > 0
    size = np.zeros(len(known))
    if not known.any():
        return 0.0, 0, Missing(size, np.zeros((len(known), 0)), np.zeros(score.taken.shape[1]))
    score = score.only(known)
    unit = np.sqrt(score.own)
    values, vectors = np.linalg.eigh(score.variance / np.outer(unit, unit))
    seen = values > imitated
    root = np.zeros((len(known), int(seen.sum())))
    root[known] = vectors[:, seen] / np.sqrt(values[seen]) / unit[:, None]
    # In units of their standard deviations.
    parts = (vectors.T @ (score.gradient / unit))[seen] / np.sqrt(values[seen])
    statistic = float(np.sum(parts**2))
    if shrunk:
        # Directions that say no more than noise does would add its error, not the model's.
        parts = parts * np.maximum(1.0 - _CHANCE / np.maximum(parts**2, _CHANCE), 0.0)
    size = root @ parts
    return statistic, int(seen.sum()), Missing(size, root, size[known] @ score.taken)
