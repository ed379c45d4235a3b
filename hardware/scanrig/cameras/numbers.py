"""Unwraps frame ids, and counts missing frames."""

_WRAP = 65535
"""GigE Vision counts 1 … 65535, then 1 again; 0 is not used."""


class FrameNumbers:
    """Turns a camera's wrapping frame ids into increasing numbers."""

    def __init__(self) -> None:
        self.last: int | None = None
        """Highest number so far."""
        self.missing = 0
        """Frames missing between those received."""
        self._raw, self._period = 0, _WRAP

    def take(self, raw: int) -> tuple[int, int]:
        """Unwrap the id of a frame.

        Args:
            raw: The camera's id of the frame.

        Returns:
            number: Its number; for the first frame its id.
            advance: Difference to the highest number so far: 1 for the next frame, 0 for a repeated one, negative
                for a late one.
        """
        if self.last is None:
            self.last, self._raw = raw, raw
            return raw, 1
        advance = raw - self._raw
        # Some cameras also use 0.
        self._period = _WRAP + 1 if raw == 0 else self._period
        if max(raw, self._raw) <= _WRAP and abs(advance) > _WRAP // 2:
            advance += self._period if advance < 0 else -self._period
        number = self.last + advance
        if advance > 0:
            self.missing += advance - 1
            self.last, self._raw = number, raw
        return number, advance
