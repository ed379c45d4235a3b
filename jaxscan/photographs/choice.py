"""Which of many photographs are looked at."""

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner


Use = Literal["points", "pictures"]
"""What photographs are for: colours of measured points, or panoramas, textures and posed images."""
LEAST: dict[Use, int] = {"points": 60, "pictures": 180}
"""Photographs of a turn that are looked at, however wide the lens: what is hidden to one is seen by the next."""
OVERLAP: dict[Use, int] = {"points": 8, "pictures": 16}
"""Photographs that show a place, at the least. With three times as many, colours of points in a rendered corner of a
room are closer to the true ones by 0.1 dB."""


def enough_photographs(scanner: Scanner, use: Use) -> int:
    """Photographs of a turn that show every place often enough, whatever the lens."""
    camera = scanner.camera
    narrowest = 2 * np.arctan(min(camera.width / float(camera.fx), camera.height / float(camera.fy)) / 2)
    return max(LEAST[use], int(np.ceil(OVERLAP[use] * 2 * np.pi / narrowest)))


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
