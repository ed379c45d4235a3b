"""How well the motion stops where it is told to: learned from boards that were seen from several positions."""

import numpy as np
from scipy.optimize import minimize_scalar  # type: ignore[import-untyped]

from jaxscan.calibration.solve.joint import Linearised
from jaxscan.calibration.solve.problem import LEAST_STOP_SIGMA, used_stops


# Twice the gain in log-likelihood from which stops are believed to err: by chance one calibration in 40 has it.
_BELIEVED = 4.0
# Stops err by less than this in any case [rad or m].
_MOST = 0.05
# Share of the largest information that is rounding error.
_ROUNDING = 1e-9


def learn_stop_sigma(linearised: Linearised) -> float:
    r"""Standard deviation of the stops about the positions of their records [rad or m], by restricted likelihood.

    With all other unknowns eliminated the data have the information $M$ on the stops, and at their positions the
    gradient $g \sim N(0, M + \sigma^2 M^2)$: one variance, in the eigenvectors of $M$.

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
    gradient = axes.T @ (whole @ np.asarray(problem.stops)[block, column])
    seen = size > _ROUNDING * max(float(size[-1]), _ROUNDING)
    size, square = size[seen], gradient[seen] ** 2 / size[seen]

    def unlikely(log_ratio: float) -> float:
        larger = 1.0 + np.exp(2.0 * log_ratio) * size
        return float(np.sum(np.log(larger) + square / larger))

    present = float(problem.stop_sigma)
    most = np.log(_MOST / present)
    start = np.linspace(np.log(LEAST_STOP_SIGMA / present), most, 60)
    best = int(np.argmin([unlikely(ratio) for ratio in start]))
    around = start[max(best - 1, 0)], start[min(best + 1, len(start) - 1)]
    found = minimize_scalar(unlikely, bounds=around, method="bounded")
    believed = float(np.sum(square)) - found.fun > _BELIEVED
    return max(present * float(np.exp(found.x)), LEAST_STOP_SIGMA) if believed else LEAST_STOP_SIGMA

