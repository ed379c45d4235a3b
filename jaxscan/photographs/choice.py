"""Which of many photographs are looked at."""

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner


MOST = 180
"""Photographs that are looked at. More, evenly spread over a turn, change a colour by less than its rounding."""
OVERLAP = 16
"""Photographs that show a place, at the least: of a narrow lens, more than `MOST` are looked at."""


def enough_photographs(scanner: Scanner) -> int:
    """Photographs of a turn that show every place often enough, whatever the lens."""
    camera = scanner.camera
    narrowest = 2 * np.arctan(min(camera.width / float(camera.fx), camera.height / float(camera.fy)) / 2)
    return max(MOST, int(np.ceil(OVERLAP * 2 * np.pi / narrowest)))


def choose_evenly(
    places: Float[np.ndarray, " n"], most: int, *, period: float | None = None
) -> Int[np.ndarray, " chosen"]:
    """Choose by place, not by number: the sweep may have gone over one part twice, or more slowly.

    Args:
        places: Angle [rad] or position [m] of each photograph.
        most: So many are chosen at the most: one of each of as many equal parts of the way.
        period: After which a place is the same again; None where it never is.

    Returns:
        Which, in the order that they have.
    """
    if len(places) <= most:
        return np.arange(len(places))
    places = np.asarray(places, np.float64)
    low, way = float(places.min()), float(np.ptp(places))
    if period is not None and way >= period:
        places, low, way = np.mod(places, period), 0.0, period
    # A little more than nothing, or rounding would put the places of an even sweep into parts beside theirs.
    part = np.floor((places - low) / max(way, 1e-12) * most + 1e-6).astype(np.int64)
    return np.sort(np.unique(np.minimum(part, most - 1), return_index=True)[1])
