"""Notices when the light of the room changes during a capture."""

_FACTOR = 2.0
"""Change that is reported."""
_BLACK_DN = 2.0
"""Level that is added before the comparison: in the dark a count more or less is no change."""


class LightWatch:
    """Follows the mean level of the laser-off frames."""

    def __init__(self) -> None:
        self._level_dn: float | None = None

    def add(self, level_dn: float) -> float | None:
        """Add a pair.

        Returns:
            The level before [DN] if the light has changed by a factor of two since; None if not.
        """
        was = self._level_dn
        if was is not None and 1 / _FACTOR < (level_dn + _BLACK_DN) / (was + _BLACK_DN) < _FACTOR:
            return None
        self._level_dn = level_dn
        return was
