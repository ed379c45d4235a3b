"""The records whose laser-off images are used, in the order in which features go through them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


MOST_KEYS = 120
_SHARE = 0.6
"""Of an image's field of view that the next one shows too, at least."""
_FEWEST_KEYS = 3


class KeyImages(NamedTuple):
    """Key images of a sweep, in the order in which the scanner turned."""

    record: Int[np.ndarray, " keys"]
    heading: Float[np.ndarray, " keys"]
    """Turned angle of each [rad]."""
    closing: Int[np.ndarray, " again"]
    """Numbers of the first key images, to which those after the last one lead again; empty without a full turn."""

    def walk(self) -> Int[np.ndarray, " steps"]:
        """The key image of each step."""
        return np.concatenate([np.arange(len(self.record)), self.closing])


def choose_keys(heading: Float[np.ndarray, " records"], field_rad: float, most: int = MOST_KEYS) -> KeyImages | None:
    """Key images spread evenly over the angle that a sweep turned by.

    Args:
        heading: Turned angle of every record [rad].
        field_rad: The camera's field of view about the axis [rad].
        most: Key images, at most.

    Returns:
        The key images; None where neighbours would overlap too little, or the sweep turned too little.
    """
    order = np.argsort(heading, kind="stable")
    turned = float(np.ptp(heading)) if len(heading) else 0.0
    if len(heading) < _FEWEST_KEYS or turned <= 0:
        return None
    wanted = np.linspace(heading.min(), heading.max(), min(most, len(heading)))
    at = np.unique(_nearest(heading[order], wanted))
    record = order[at]
    angle = heading[record]
    widest = (1.0 - _SHARE) * field_rad
    if len(record) < _FEWEST_KEYS or np.diff(angle).max() > widest:
        return None
    # After the last image comes the first one that lies beyond it, a turn earlier.
    beyond = np.flatnonzero(angle + 2 * np.pi > angle[-1] - 1e-9)
    gap = angle[beyond[0]] + 2 * np.pi - angle[-1] if len(beyond) else np.inf
    again = np.flatnonzero((angle + 2 * np.pi > angle[-1] - 1e-9) & (angle < angle[-1] - 2 * np.pi + field_rad))
    return KeyImages(record, angle, again if gap <= widest else np.zeros(0, int))


def _nearest(ascending: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Numbers of the values nearest to the wanted ones."""
    right = np.clip(np.searchsorted(ascending, wanted), 1, len(ascending) - 1)
    return np.where(wanted - ascending[right - 1] <= ascending[right] - wanted, right - 1, right)
