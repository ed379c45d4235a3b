"""Stripes of a sweep whose lasers take turns, while it is being taken: as many engines as there are lasers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxscan.files.capture import CaptureHeader
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import IncomingStripes, PlannedSweep, ReconstructSettings, RecordedPair


def stripes_to_come(
    header: CaptureHeader, scanner: Scanner, steps: int, settings: ReconstructSettings
) -> "IncomingStripes | LasersInTurn":
    """What finds the stripes of a sweep while it is taken.

    Args:
        header: Of its capture.
        scanner: The calibrated rig.
        steps: Records of the whole sweep.
        settings: As of `reconstruct`.

    Raises:
        CaptureError, CalibrationError, ValueError: As of `IncomingStripes`.
    """
    camera = header.camera
    carries = None if header.turntable is None else header.turntable.carries
    size = (camera.width, camera.height)
    sweep = PlannedSweep(camera.pixel_format, camera.response, header.lasers, size, carries, steps)
    return (IncomingStripes if len(header.lasers) == 1 else LasersInTurn)(sweep, scanner, settings)


class LasersInTurn:
    """`IncomingStripes` of several lasers: record r shows laser r modulo their number.

    Each laser's search learns from its own first records. The finished sweep learns from the first of all, so this
    counts points while the sweep is taken, and the cloud is reconstructed from the disk in the end.
    """

    def __init__(self, sweep: PlannedSweep, scanner: Scanner, settings: ReconstructSettings) -> None:
        """Check that sweep and scanner fit together.

        Raises:
            CaptureError, CalibrationError, ValueError: As of `IncomingStripes`.
        """
        self._turns = len(sweep.lasers)
        steps = sweep.steps // self._turns
        self._engines = tuple(
            IncomingStripes(replace(sweep, lasers=(line,), steps=steps), scanner, settings) for line in sweep.lasers
        )

    @property
    def size(self) -> int:
        """Records computed at a time."""
        return self._engines[0].size

    @property
    def needed(self) -> int:
        """Records at the start of the sweep from which is learned."""
        return self._turns * self._engines[0].needed

    @property
    def learned(self) -> bool:
        """Whether stripes can be found."""
        return all(engine.learned for engine in self._engines)

    @property
    def points(self) -> np.ndarray:
        """Points of each record; -1 where its stripes are not known [records]."""
        return np.stack([engine.points for engine in self._engines], axis=1).ravel()

    def learn(self, pairs: Sequence[RecordedPair]) -> None:
        """Prepare each laser's search from the first `needed` records, in their order.

        Raises:
            CaptureError: If they do not tell a laser's colour.
        """
        for engine, theirs in zip(self._engines, self._shared(pairs), strict=True):
            engine.learn(theirs)

    def compute(self, pairs: Sequence[RecordedPair]) -> None:
        """Find the stripes of some records, and count their points.

        Raises:
            ValueError: If nothing was learned yet.
        """
        for engine, theirs in zip(self._engines, self._shared(pairs), strict=True):
            engine.compute(theirs)

    def _shared(self, pairs: Sequence[RecordedPair]) -> list[list[RecordedPair]]:
        """The pairs of each laser, numbered by its own records."""
        return [
            [pair._replace(number=pair.number // self._turns) for pair in pairs if pair.number % self._turns == laser]
            for laser in range(self._turns)
        ]
