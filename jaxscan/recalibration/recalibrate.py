"""Sweeps and a stored calibration to a better one, or to the reason why not."""

from collections.abc import Callable, Sequence

from jaxscan.calibration import Calibration
from jaxscan.recalibration.given import Given
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.result import Recalibration
from jaxscan.recalibration.settings import RecalibrationSettings


Progress = Callable[[int, int], None]


def recalibrate(
    sweeps: Sequence[SweepStripes],
    stored: Calibration,
    settings: RecalibrationSettings | None = None,
    given: Given | None = None,
    *,
    progress: Progress | None = None,
) -> Recalibration:
    """Refine a stored calibration with sweeps of a room that have planes in them.

    Args:
        sweeps: Stripes of each sweep; their `station` tells from where each was taken.
        stored: Its covariance is the prior; nothing in it is changed.
        settings: Of the recalibration.
        given: Beside the sweeps: tracks, known lengths, spheres, boards, places of stations.
        progress: Called with (stages done, stages in all).

    Returns:
        The new scanner and everything by which it can be judged. Where the update is refused, `updated` is False,
        `refused` says why in one line, and the scanner is the stored one.

    Raises:
        CalibrationError: If nothing can be adjusted at all: no sweeps, no plane in them, a stored calibration without
            covariance, sheet or table, or sweeps of a camera of another size.
    """
    raise NotImplementedError
