"""Stripes of a growing sweep whose lasers take turns: one engine per laser."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxscan.files.capture import CaptureHeader
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import IncomingStripes, PlannedSweep, ReconstructSettings, RecordedPair, Show


def stripes_to_come(
    header: CaptureHeader, scanner: Scanner, steps: int, settings: ReconstructSettings, show: Show | None = None
) -> "IncomingStripes | LasersInTurn":
    """The engine, or engines, that find the stripes of a sweep while it is taken.

    Args:
        header: The header of its capture.
        scanner: The calibrated rig.
        steps: Records of the whole sweep.
        settings: As for `reconstruct`.
        show: As of `IncomingStripes`.

    Raises:
        CaptureError, CalibrationError, ValueError: As of `IncomingStripes`.
    """
    camera = header.camera
    carries = None if header.turntable is None else header.turntable.carries
    size = (camera.width, camera.height)
    sweep = PlannedSweep(
        camera.pixel_format, camera.response, header.lasers, size, carries, steps, compression=camera.compression
    )
    return (IncomingStripes if len(header.lasers) == 1 else LasersInTurn)(sweep, scanner, settings, show)


class LasersInTurn:
    """`IncomingStripes` for n lasers: record r shows laser r modulo n.

    The search of each laser learns from its own first records, but the finished sweep learns from the first records
    of all lasers. Therefore this class only counts points; in the end the cloud is reconstructed from the disk.
    """

    def __init__(
        self, sweep: PlannedSweep, scanner: Scanner, settings: ReconstructSettings, show: Show | None = None
    ) -> None:
        """Check that the sweep fits the scanner.

        Raises:
            CaptureError, CalibrationError, ValueError: As of `IncomingStripes`.
        """
        self._turns = len(sweep.lasers)
        steps = sweep.steps // self._turns
        self._engines = tuple(
            IncomingStripes(replace(sweep, lasers=(line,), steps=steps), scanner, settings, show)
            for line in sweep.lasers
        )

    @property
    def size(self) -> int:
        """The number of records that are computed at once."""
        return self._engines[0].size

    @property
    def needed(self) -> int:
        """The number of records at the start of the sweep from which the search learns."""
        return self._turns * self._engines[0].needed

    @property
    def learned(self) -> bool:
        """Whether stripes can be found."""
        return all(engine.learned for engine in self._engines)

    @property
    def points(self) -> np.ndarray:
        """Number of points of each record [records]; -1 where its stripes are not found yet."""
        return np.stack([engine.points for engine in self._engines], axis=1).ravel()

    def learn(self, pairs: Sequence[RecordedPair]) -> None:
        """Prepare each laser's search from the first `needed` records, in their order.

        Raises:
            CaptureError: If they do not show the colour of a laser.
        """
        for engine, theirs in zip(self._engines, self._shared(pairs), strict=True):
            engine.learn(theirs)

    def compute(self, pairs: Sequence[RecordedPair]) -> None:
        """Find the stripes of some records, and count their points.

        Raises:
            ValueError: Before `learn`.
        """
        for engine, theirs in zip(self._engines, self._shared(pairs), strict=True):
            engine.compute(theirs)

    def _shared(self, pairs: Sequence[RecordedPair]) -> list[list[RecordedPair]]:
        """The pairs of each laser, renumbered from 0."""
        return [
            [pair._replace(number=pair.number // self._turns) for pair in pairs if pair.number % self._turns == laser]
            for laser in range(self._turns)
        ]
