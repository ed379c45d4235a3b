"""Whether the laser shines on in the laser-off frames: what no single pair can say."""

from collections import deque
from statistics import median


PLACES = 8
"""Places over which a leak is judged: wallpaper with stripes along the laser's line looks like one at every third."""
APART_DEG = 2.0
"""Turn from which on the line falls on something else."""


class LeakWatch:
    """Follows how much of the line is in the laser-off frame too, from place to place.

    Texture of the room that runs along the line looks like a leak of a tenth to a third, of either sign, at one place.
    It does not at the next, which the light of a laser that is slow to go out does.
    """

    def __init__(self) -> None:
        self._leaks: deque[float] = deque(maxlen=PLACES)
        self._last_deg: float | None = None

    def add(self, angle_deg: float | None, leak: float) -> float | None:
        """Take note of a pair.

        Args:
            angle_deg: Where the table stood; None where the scene is another in each pair, as with boards.
            leak: Part of the line's light that is in the laser-off frame, `PairProof.leak`.

        Returns:
            The median over the last `PLACES` places; None before there are so many, and where the table has hardly
            moved since the last.
        """
        if angle_deg is not None:
            if self._last_deg is not None and abs(angle_deg - self._last_deg) < APART_DEG - 1e-9:
                return None
            self._last_deg = angle_deg
        self._leaks.append(leak)
        return median(self._leaks) if len(self._leaks) == PLACES else None
