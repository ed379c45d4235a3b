"""Lost steps in the corrections of angles that an adjustment has found."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.leastsq import MEDIAN_TO_SIGMA
from jaxscan.recalibration.adjusted import Adjusted
from jaxscan.recalibration.table.jumps import LEAST_STEP, LEAST_Z, MOST_JUMPS, inflation
from jaxscan.recalibration.table.names import say_jump
from jaxscan.recalibration.table.regression import Prior, Rows, fit_steps


WAVES = 3
"""Errors that repeat up to so many times per turn are no lost steps."""
LEAST_RECORDS = 24


def say_lost_steps(adjusted: Adjusted, names: Sequence[str]) -> list[str]:
    """Sentences for the jumps in the corrections of an adjustment with one angle per step.

    Args:
        adjusted: Its corrections follow the sweeps of its observations.
        names: Names of the sweeps.
    """
    each = zip(names, adjusted.observations.angles, adjusted.corrections, adjusted.correction_sigma, strict=True)
    return [
        say_jump(name, (record - 1, record), float(np.rad2deg(size)), float(np.rad2deg(sigma[record])))
        for name, angle, correction, sigma in each
        for record, size in sorted(jumps_in(angle, correction, sigma))
    ]


def jumps_in(
    angle: Float[np.ndarray, " records"],
    correction: Float[np.ndarray, " records"],
    sigma: Float[np.ndarray, " records"],
) -> list[tuple[int, float]]:
    """Record and angle [rad] of each jump in the corrections of one sweep.

    Their stated sigmas hold the errors that all records share, and a step does not see those: the scatter between
    neighbours, which one step does not change, sets the scale.
    """
    count = len(correction)
    if count < LEAST_RECORDS or not np.any(sigma > 0):
        return []
    # Neighbours scatter by this, with the median so that steps do not count.
    scatter = MEDIAN_TO_SIGMA * float(np.median(np.abs(np.diff(correction)))) / np.sqrt(2.0)
    scale = np.full(count, max(scatter, 1e-3 * LEAST_STEP))
    waves = [wave(h * angle) for h in range(1, WAVES + 1) for wave in (np.sin, np.cos)]
    nuisance = [np.ones(count), angle, *waves]
    found: list[tuple[int, float]] = []
    while len(found) < MOST_JUMPS:
        # Steps that are known stay free in size.
        columns = np.stack([*nuisance, *(1.0 * (np.arange(count) >= record) for record, _ in found)], axis=-1)
        rows = Rows(correction / scale, 1.0 / scale, columns / scale[:, None], np.arange(count))
        test, left = fit_steps(rows, count, Prior(np.zeros(columns.shape[1]), np.full(columns.shape[1], 1.0)))
        z = np.abs(test.size) / test.sigma / inflation(rows, left, count)
        record = int(np.argmax(z))
        if z[record] < LEAST_Z or abs(test.size[record]) < LEAST_STEP:
            break
        found.append((record, float(test.size[record])))
    if not found:
        return []
    columns = np.stack([*nuisance, *(1.0 * (np.arange(count) >= record) for record, _ in found)], axis=-1)
    sizes = np.linalg.lstsq(columns, correction)[0][-len(found) :]
    return [(record, float(size)) for (record, _), size in zip(found, sizes, strict=True)]
