"""The chunks of a sweep, read once although its first records are looked at before they are computed."""

from collections.abc import Iterator

import numpy as np

from jaxscan.reconstruction.sweep import FrameChunk, SweepSource


class ReadOnce:
    """Chunks in order; those with the first records wait here, while the next ones are already being decoded."""

    def __init__(self, sweep: SweepSource, size: int) -> None:
        self._chunks = sweep.chunks(size)
        self._waiting: list[FrameChunk] = []

    def first(self, count: int) -> FrameChunk:
        """The first records, of which there are at least so many, in whatever chunks they lie; before `chunks`."""
        while sum(len(chunk.on) for chunk in self._waiting) < count:
            self._waiting.append(next(self._chunks))
        if len(self._waiting) == 1:
            on, off = self._waiting[0]
        else:
            on = np.concatenate([chunk.on for chunk in self._waiting])
            offs = [chunk.off for chunk in self._waiting if chunk.off is not None]
            off = np.concatenate(offs) if offs else None
        return FrameChunk(on[:count], None if off is None else off[:count])

    def chunks(self) -> Iterator[FrameChunk]:
        """All chunks, once."""
        while self._waiting:
            yield self._waiting.pop(0)
        yield from self._chunks
