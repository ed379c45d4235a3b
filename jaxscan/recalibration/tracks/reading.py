"""Laser-off images of a sweep, read ahead."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Int

from jaxscan.recalibration.tracks.seen import FeatureEyes, ImageSource


_AHEAD, _THREADS = 4, 2
_LEVEL, _BRIGHT = 90.0, 250
_MOST_BRIGHT = 0.02
"""Share of saturated pixels in the chosen exposure, at most."""


class Reader:
    """Reads grey laser-off images of one exposure."""

    def __init__(self, capture: ImageSource, eyes: FeatureEyes) -> None:
        self._capture, self._to_grey = capture, eyes.to_grey
        self._exposure = 0
        images = capture.records[0].off
        if len(images) > 1:
            grey = [self._grey(image) for image in images]
            clear = [k for k, g in enumerate(grey) if (g >= _BRIGHT).mean() <= _MOST_BRIGHT] or [0]
            self._exposure = min(clear, key=lambda k: abs(float(np.median(grey[k])) - _LEVEL))

    def read(self, record: int) -> np.ndarray:
        """The image of one record, uint8 [rows, columns]."""
        images = self._capture.records[record].off
        return self._grey(images[min(self._exposure, len(images) - 1)])

    def ahead(self, records: Int[np.ndarray, " n"]) -> Iterator[np.ndarray]:
        """The images of some records in order, decoded in threads."""
        with ThreadPoolExecutor(_THREADS) as pool:
            waiting: deque[Future[np.ndarray]] = deque()
            try:
                for record in records:
                    waiting.append(pool.submit(self.read, int(record)))
                    if len(waiting) > _AHEAD:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()

    def _grey(self, reference: object) -> np.ndarray:
        return self._to_grey(self._capture.image(reference), self._capture.pixel_format)
