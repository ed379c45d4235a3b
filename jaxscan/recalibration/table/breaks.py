"""Large lost steps as breaks of walls: where a wall turns about the axis from one profile to the next."""

import numpy as np
from jaxtyping import Float

from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.table.patches import FOLD, HALF, SAME, Grid, normals
from jaxscan.recalibration.table.walls import LINES, PROFILES, Rig, take_sample, turn


LEAST_BREAK = np.deg2rad(0.35)
"""Smaller breaks are lost in the noise of normals, and found by their least squares."""
MOST_TILT = np.deg2rad(1.5)
"""Difference of the tilts of two parts of one wall."""
LEAST_LINES = 5
"""On which the wall is seen on both sides."""
APART = 6
"""Cells between two breaks that are proposed."""
MOST_BREAKS = 3


def propose_steps(sweep: SweepStripes, rig: Rig) -> list[tuple[int, float]]:
    """Records at which walls break by a turn about the axis, and that turn [rad], the largest first.

    Normals before and behind a place are compared line by line, and their median is taken. The edge of a cupboard
    breaks a wall too: every proposal has to be tried.
    """
    sample = take_sample(sweep, rig.scanner, PROFILES, PROFILES * LINES)
    one = sample.stripes.laser == sample.stripes.laser[0]
    index = np.flatnonzero(one)
    records, row = np.unique(sample.record[index], return_inverse=True)
    if len(records) < 4 * HALF + 2:
        return []
    angle = rig.theta[sample.record[index]]
    shape = (len(records), int(sample.column.max()) + 1)
    grid = Grid(np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape, bool))
    cells = row, sample.column[index]
    grid.x[cells], grid.noise[cells] = turn(angle, sample.x[index]), turn(angle, sample.noise[index])
    grid.valid[cells] = True
    size = _breaks(grid)
    found: list[tuple[int, float]] = []
    left = np.abs(size)
    while len(found) < MOST_BREAKS and left.max() > LEAST_BREAK:
        cell = int(np.argmax(left))
        found.append((int(records[cell]), float(size[cell])))
        left[max(cell - APART, 0) : cell + APART + 1] = 0.0
    return found


def _breaks(grid: Grid) -> Float[np.ndarray, " profiles"]:
    """The turn that makes one wall of its parts before each profile and from it on; 0 where there are none [rad]."""
    normal, flat = normals(grid)
    upright = np.hypot(normal[..., 0], normal[..., 1])
    azimuth, tilt = np.arctan2(normal[..., 1], normal[..., 0]), np.arcsin(np.clip(normal[..., 2], -1, 1))
    distance = np.sum(normal * grid.x, axis=-1)
    size = np.linalg.norm(grid.x, axis=-1)
    # Windows end at the place, and begin at it.
    first, second = np.s_[: -2 * HALF - 1], np.s_[2 * HALF + 1 :]
    turned = (azimuth[first] - azimuth[second] + np.pi) % (2 * np.pi) - np.pi
    same = (
        flat[first]
        & flat[second]
        & (np.minimum(upright[first], upright[second]) > 0.5)
        & (np.abs(turned) < FOLD)
        & (np.abs(tilt[first] - tilt[second]) < MOST_TILT)
        & (np.abs(distance[first] - distance[second]) < SAME * np.maximum(size[first], size[second]))
    )
    enough = np.count_nonzero(same, axis=1) >= LEAST_LINES
    breaks = np.zeros(len(flat))
    with np.errstate(invalid="ignore"):
        middle = np.nanmedian(np.where(same, turned, np.nan)[enough], axis=1)
    breaks[HALF + 1 : HALF + 1 + len(enough)][enough] = middle
    return breaks
