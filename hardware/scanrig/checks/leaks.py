"""Detects a laser that shines in the laser-off frames too, from several pairs; a single pair cannot show it."""

from collections import deque
from statistics import median


PLACES = 8
"""Places over which a leak is judged: striped wallpaper along the laser's line looks like a leak at every third."""
APART_DEG = 2.0
"""Least turn after which the laser's line counts as falling on another place."""


class LeakWatch:
    """Follows the leak of the laser's line into the laser-off frames, from place to place.

    Texture along the line looks like a leak of a tenth to a third, of either sign, but only at single places. A laser
    that goes out slowly leaks at every place.
    """

    def __init__(self) -> None:
        self._leaks: deque[float] = deque(maxlen=PLACES)
        self._last_deg: float | None = None

    def add(self, angle_deg: float | None, leak: float) -> float | None:
        """Add a pair.

        Args:
            angle_deg: The table's angle; None if every pair shows another scene, as with boards.
            leak: `PairProof.leak`.

        Returns:
            The median over the last `PLACES` places; None while there are fewer, and if the table has hardly moved
            since the last.
        """
        if angle_deg is not None:
            if self._last_deg is not None and abs(angle_deg - self._last_deg) < APART_DEG - 1e-9:
                return None
            self._last_deg = angle_deg
        self._leaks.append(leak)
        return median(self._leaks) if len(self._leaks) == PLACES else None
