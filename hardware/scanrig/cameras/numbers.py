"""Frame ids without wraps, and how many frames are missing between them."""

_WRAP = 65535
"""GigE Vision counts 1 … 65535, then 1 again; 0 is no frame."""


class FrameNumbers:
    """Turns what a camera counts into numbers that only rise."""

    def __init__(self) -> None:
        self.last: int | None = None
        """Number of the newest frame so far."""
        self.missing = 0
        """Frames between those that came."""
        self._raw, self._period = 0, _WRAP

    def take(self, raw: int) -> tuple[int, int]:
        """One more frame.

        Args:
            raw: Its id as the camera says.

        Returns:
            number: Its number: the first frame's is its id.
            advance: By how much that is more than the last: 1 for the next frame, 0 for the same again, less for
                one that is late.
        """
        if self.last is None:
            self.last, self._raw = raw, raw
            return raw, 1
        advance = raw - self._raw
        # Some cameras use 0 like any other number.
        self._period = _WRAP + 1 if raw == 0 else self._period
        if max(raw, self._raw) <= _WRAP and abs(advance) > _WRAP // 2:
            advance += self._period if advance < 0 else -self._period
        number = self.last + advance
        if advance > 0:
            self.missing += advance - 1
            self.last, self._raw = number, raw
        return number, advance
