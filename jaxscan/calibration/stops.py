"""How well the motion stops at its commanded positions: learned from boards that were seen from several of them.

An error that comes back at the same position, or follows it smoothly, is a fault of the motion's model, and no stop's.
"""

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.joint import Linearised
from jaxscan.calibration.problem import LEAST_STOP_SIGMA, Problem, used_stops
from jaxscan.geometry import LinearStage


# Twice the gain in log-likelihood from which stops are taken to err: by chance one calibration in 40 has it.
_BELIEVED = 4.0
# What errs by more is no stop but another fault: a lost step, a slipping belt, a wrong model of the table [rad or m].
_MOST = 1e-3
# Share of the largest information that is rounding error.
_ROUNDING = 1e-9
# Faults that move the images by this share of the plainest are the poses' own: a turn of all stops of a placement.
_FAINT = 1e-3
# Each time the likeliest is sought among thirty times finer ones: the last are a ten-thousandth apart.
_ZOOMS = 3
_POWERS, _WAVES = (1, 2, 3, 4), (1, 2)


def learn_stop_sigma(linearised: Linearised) -> float:
    r"""Standard deviation of the stops about the positions of their records [rad or m], by restricted likelihood.

    With all other unknowns eliminated the data have the information $M$ on the stops, and at their positions the
    gradient $g \sim N(M F \beta, M + \sigma^2 M^2)$ with the faults $F$ of `faults_of_motion`.

    Returns:
        The most likely one; `LEAST_STOP_SIGMA` where exact stops explain the boards as well.

    Source: Patterson and Thompson (1971), restricted maximum likelihood of a variance component.
    """
    problem, covariance = linearised.problem, linearised.covariance
    block, column = np.nonzero(used_stops(problem))
    if not len(block):
        return LEAST_STOP_SIGMA
    coupling = covariance.coupling[block, 6 + column]
    beside = covariance.alone[block[:, None], (6 + column)[:, None], (6 + column)[None]]
    spread = coupling @ covariance.shared @ coupling.T + np.where(block[:, None] == block[None], beside, 0.0)
    # In units of the present sigma, whose prior is in the covariance.
    whole = np.linalg.inv(spread)
    size, axes = np.linalg.eigh(whole - np.eye(len(whole)))
    seen = size > _ROUNDING * max(float(size[-1]), _ROUNDING)
    root, axes = np.sqrt(size[seen]), axes[:, seen]
    part = axes.T @ (whole @ np.asarray(problem.stops)[block, column]) / root
    faults = faults_of_motion(problem)[block, column]
    left, values, _ = np.linalg.svd(root[:, None] * (axes.T @ faults))
    rank = int(np.sum(values > _FAINT * np.max(values, initial=0.0)))
    free = left[:, rank:]
    size, axes = np.linalg.eigh(free.T @ (root[:, None] ** 2 * free))
    square = (axes.T @ (free.T @ part)) ** 2
    if not len(square):
        return LEAST_STOP_SIGMA

    def unlikely(log_ratio: float) -> float:
        larger = 1.0 + np.exp(2.0 * log_ratio) * size
        return float(np.sum(np.log(larger) + square / larger))

    present = float(problem.stop_sigma)
    low, high = np.log(LEAST_STOP_SIGMA / present), np.log(_MOST / present)
    for _ in range(_ZOOMS):
        tried = np.linspace(low, high, 60)
        best = int(np.argmin([unlikely(ratio) for ratio in tried]))
        low, high = tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)]
    believed = float(np.sum(square)) - unlikely(tried[best]) > _BELIEVED
    return max(present * float(np.exp(tried[best])), LEAST_STOP_SIGMA) if believed else LEAST_STOP_SIGMA


def faults_of_motion(problem: Problem) -> Float[np.ndarray, "placements stops terms"]:
    """Errors of the positions of all stops [rad or m] that are no chance.

    Waves of a table or powers of the travel of a stage, and for each position that several placements were seen from
    an error that they share.
    """
    view, number = np.nonzero(problem.stop)
    position = np.zeros(np.shape(problem.stops))
    position[np.asarray(problem.placement)[view], number] = np.asarray(problem.angle)[view]
    there = used_stops(problem)
    each, count = np.unique(position[there], return_counts=True)
    again = position[..., None] == each[count > 1]
    if isinstance(problem.turntable, LinearStage):
        travel = position / max(float(np.max(np.abs(position))), 1e-300)
        smooth = [travel**power for power in _POWERS]
    else:
        smooth = [wave for h in _WAVES for wave in (np.cos(h * position) - 1.0, np.sin(h * position))]
    return np.where(there[..., None], np.concatenate([np.stack(smooth, axis=-1), again], axis=-1), 0.0)
