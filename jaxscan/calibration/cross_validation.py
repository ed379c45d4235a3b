"""Cross-validation: parts of the observations, solved apart, must give the same rig.

Two halves of the records judge all models together. The middle of the image judges the lens where no corner was seen:
a model that is right is the same in the middle as in the whole, and one that is not goes astray beyond its data. The
lines on boards that were left out are put back: the sheet should stay where it is.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration.adjust import Adjustment, solve_again
from jaxscan.calibration.joint import Linearised
from jaxscan.calibration.problem import layout_of, prepare
from jaxscan.calibration.propagate import field_radius
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.sheets import Lifted, lift_stripes
from jaxscan.geometry import LaserSheet
from jaxscan.leastsq import MEDIAN_TO_SIGMA, Huber
from jaxscan.observation import Observations


# Directions of which a part knows less than this share beyond the priors, or beyond the whole.
_PRIOR_HELD = 0.05
# The middle of the image reaches to the farthest corner as that to the end of the image, within these bounds.
_MIDDLE = (0.6, 0.9)
# Corners that count as the farthest reach beyond this share of all.
_FARTHEST = 0.995
# Where corners reach this share of the way to the end of the image, no lens is asked beyond them.
_REACHED = 0.95
# Difference of the correlations of two unknowns, taken either way, up to which they are more than rounding.
_SYMMETRIC = 1e-6
# Rounds of weights and solves of a sheet, and its directions that lines all but leave open [share of the largest].
_LINE_ROUNDS, _LINE_RCOND = 10, 1e-6
# Corners of a view in the middle of the image that still fix its pose well.
_LEAST_CORNERS = 8


class Split(NamedTuple):
    """The difference of two solves of parts of the observations, along directions that the data know."""

    difference: np.ndarray
    """Difference of the free unknowns [free], scaled units."""
    free: np.ndarray
    """bool [shared]: which unknowns those are."""
    whiten: np.ndarray
    """Leads the difference to independent directions [directions, free]."""
    scatter: np.ndarray
    """Variance by noise along them [directions]."""
    per_error: float
    """The difference as large as this many times the error of the whole calibration [1]."""

    @property
    def dof(self) -> int:
        """Directions that the data know beyond the priors."""
        return len(self.scatter)

    def distance(self, systematic: np.ndarray | None = None) -> float:
        """Square of the difference in units of its standard deviation."""
        covariance, parts = np.diag(self.scatter), self.whiten @ self.difference
        if systematic is not None:
            covariance = covariance + self.per_error**2 * self.whiten @ systematic @ self.whiten.T
        return float(parts @ np.linalg.solve(covariance, parts))

    def beyond(self, before: np.ndarray, scales: np.ndarray) -> np.ndarray:
        """The step [shared] that covers what neither noise nor other findings do, in the units of the unknowns."""
        unit = scales[self.free]
        covered = before[np.ix_(self.free, self.free)] / np.outer(unit, unit)
        share = min(self.dof / max(self.distance(covered), 1e-300), 1.0)
        step = np.zeros(len(scales))
        step[self.free] = np.sqrt(1.0 - share) / self.per_error * self.difference * unit
        return step

    def noise(self, scales: np.ndarray) -> np.ndarray:
        """What noise does to the difference [directions, shared], in the units of the unknowns."""
        steps = np.zeros((self.dof, len(scales)))
        steps[:, self.free] = (np.linalg.pinv(self.whiten) * np.sqrt(self.scatter)).T * scales[self.free]
        return steps


def compare_halves(
    result: Adjustment, settings: CalibrationSettings, promise: tuple[float, np.ndarray | float]
) -> Split | None:
    """Two calibrations from half of the records each; None where they cannot be had.

    Records are dealt out in turn inside each placement, so that both halves keep several angles. Weights of corners
    and stripes are multiplied by `promise`.
    """
    half = deal_halves(np.asarray(result.data.placement), result.view_inlier & result.data.fixes_pose)
    if min(np.count_nonzero(half == 0), np.count_nonzero(half == 1)) < 3:
        return None
    parts = [_solved(result, settings, (half == side)[:, None], promise) for side in (0, 1)]
    if parts[0] is None or parts[1] is None:
        return None
    step, covariance, sampling = (np.array(both) for both in zip(*parts, strict=True))
    # A mean of two errors that are independent has half the sigma of one, their difference twice that.
    return _split(result, step[0] - step[1], covariance.sum(0), sampling.sum(0), 2.0)


def compare_regions(result: Adjustment, settings: CalibrationSettings) -> Split | None:
    """The lens by the corners in the middle of the image, against that by all; None where corners are everywhere.

    The middle is chosen so that the farthest corners lie as far beyond it as the end of the image beyond them.
    """
    kept, (width, height) = result.corner_inlier, result.data.size
    end = field_radius(replace(result.problem.camera, width=width, height=height))
    radius = np.linalg.norm(result.data.corner_q - np.array([width - 1, height - 1]) / 2.0, axis=-1)
    reached = float(np.quantile(radius[kept], _FARTHEST)) / end if kept.any() else 1.0
    if reached > _REACHED:
        return None
    inner = radius <= np.clip(reached, *_MIDDLE) * reached * end
    inner = inner & (np.count_nonzero(inner & kept, axis=1) >= _LEAST_CORNERS)[:, None]
    if np.count_nonzero(inner.any(1)) < 3:
        return None
    middle, whole = _solved(result, settings, inner, (1.0, 1.0)), _known(result.linearised, _free(result))
    if middle is None or whole is None:
        return None
    # An estimate from a part differs from the best one by what the part knows less (Hausman).
    step, covariance, _ = middle
    return _split(result, step, covariance, covariance - whole, 1.0)


def put_back_lines(result: Adjustment, given: Observations) -> list[np.ndarray]:
    """How far each sheet goes where the lines count that were left out, as steps [shared]; none without such lines.

    Lines are compared as wholes, each with one voice, and one that is far off counts less (Huber): a reflection on one
    board moves nothing, but where half of the boards say otherwise the sheet is in doubt by as much.
    """
    data, problem, steps = prepare(given), result.problem, []
    agreed = np.any(result.stripe_inlier, axis=1)
    q = np.where(agreed[:, None, None], result.data.stripe_q, data.stripe_q)
    data = data._replace(stripe_q=q, stripe_valid=np.where(agreed[:, None], result.stripe_inlier, data.stripe_valid))
    lifted = lift_stripes(data, problem.camera, result.linearised.view_poses)
    layout, scales = layout_of(problem), np.asarray(problem.scales)
    for laser in range(len(problem.lasers.distance)):
        sheet = jax.tree.map(lambda leaf, laser=laser: np.asarray(leaf)[laser], problem.lasers)
        rows = np.flatnonzero(lifted.valid.any(1) & (data.stripe_laser == laser))
        # The plane alone: lines of two sheets would be explained by a bow that none has.
        own = slice(layout.lasers.start + 5 * laser, layout.lasers.start + 5 * laser + 3)
        if agreed[rows].all() or not agreed[rows].any() or not scales[own].any():
            continue
        parts = [_line(sheet, lifted, int(row), scales[own]) for row in rows]
        step = np.zeros(len(scales))
        step[own] = (_robust_step(parts) - _robust_step([parts[k] for k in np.flatnonzero(agreed[rows])])) * scales[own]
        steps.append(step)
    return steps


def _line(sheet: LaserSheet, lifted: Lifted, row: int, scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of a line's points from a sheet in the image [points], px, and their derivatives by n1, n2, d."""
    places = np.flatnonzero(lifted.valid[row])
    points, slopes = lifted.points[row, places], lifted.slopes(np.array([row]), places[None])[0]
    per_pixel = np.linalg.norm(np.einsum("psk,ps->pk", slopes, np.asarray(sheet.slope(points))), axis=1)
    by_plane = np.column_stack([points @ np.asarray(sheet.basis).T, -np.ones(len(points))]) * scales
    return np.asarray(sheet.offset(points)) / per_pixel, by_plane / per_pixel[:, None]


def _robust_step(lines: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """The step of a sheet [scaled units] to the lines, each with one voice."""
    step, weight = np.zeros(lines[0][1].shape[1]), np.ones(len(lines))
    for _ in range(_LINE_ROUNDS):
        root = [np.sqrt(one / len(offset)) for one, (offset, _) in zip(weight, lines, strict=True)]
        slopes = np.concatenate([one * slope for one, (_, slope) in zip(root, lines, strict=True)])
        offsets = np.concatenate([one * offset for one, (offset, _) in zip(root, lines, strict=True)])
        step = -np.linalg.lstsq(slopes, offsets, rcond=_LINE_RCOND)[0]
        size = np.array([np.sqrt(np.mean((offset + slope @ step) ** 2)) for offset, slope in lines])
        weight = Huber(1.345).weights(size / max(MEDIAN_TO_SIGMA * float(np.median(size)), 1e-12)) ** 2
    return step


def deal_halves(placement: np.ndarray, used: np.ndarray) -> np.ndarray:
    """0 or 1 for every view that is used, else -1: in turn among views alone, and inside each placement."""
    half = np.full(len(placement), -1)
    count = np.bincount(placement[used], minlength=len(placement))
    alone = used & (count[placement] == 1)
    half[alone] = np.arange(alone.sum()) % 2
    for start, number in enumerate(np.flatnonzero(count > 1)):
        views = np.flatnonzero(used & (placement == number))
        half[views] = (np.arange(len(views)) + start) % 2
    return half


def _split(result: Adjustment, difference: np.ndarray, units: np.ndarray, noise: np.ndarray, per_error: float) -> Split:
    """The split for a difference, whose variance by noise is measured in units of a covariance."""
    root = np.linalg.cholesky(units)
    scatter = np.linalg.solve(root, np.linalg.solve(root, noise).T)
    variance, directions = np.linalg.eigh(0.5 * (scatter + scatter.T))
    seen = variance > _PRIOR_HELD
    return Split(difference, _free(result), directions[:, seen].T @ np.linalg.inv(root), variance[seen], per_error)


def _free(result: Adjustment) -> np.ndarray:
    return np.asarray(result.problem.scales) > 0


def _solved(
    result: Adjustment,
    settings: CalibrationSettings,
    corners: np.ndarray,
    promise: tuple[float, np.ndarray | float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The solve of some corners [views, corners or 1], and of the stripes of their views; None if it says nothing."""
    views = np.any(corners, axis=1)
    stripes = views[result.data.stripe_view]
    problem = replace(
        result.problem,
        view_used=result.problem.view_used & views,
        stripe_used=result.problem.stripe_used & stripes,
        corner_weight=result.problem.corner_weight * corners * promise[0],
        stripe_weight=result.problem.stripe_weight * stripes[:, None] * promise[1],
    )
    solution, free = solve_again(problem, settings), _free(result)
    covariance = _known(solution.linearised, free)
    if covariance is None or not solution.converged:
        return None
    reduced, prior = (part[np.ix_(free, free)] for part in (solution.linearised.reduced, solution.linearised.prior))
    return solution.shared[free], covariance, covariance @ (reduced - prior) @ covariance


def _known(linearised: Linearised, free: np.ndarray) -> np.ndarray | None:
    """Covariance of the free unknowns; None where they are not determined."""
    reduced = linearised.reduced[np.ix_(free, free)]
    # Rounding may leave a little less than 0 for unknowns that a part of the records does not show.
    size = np.sqrt(np.maximum(np.diag(reduced), 0.0))
    if not np.all(size > 0):
        return None
    correlation = reduced / np.outer(size, size)
    # A matrix that is nothing but rounding is not even symmetric.
    if (
        np.abs(correlation - correlation.T).max() > _SYMMETRIC
        or np.linalg.eigvalsh(correlation)[0] < len(size) * np.finfo(float).eps
    ):
        return None
    return np.linalg.inv(correlation) / np.outer(size, size)
