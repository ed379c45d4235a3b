"""One correction of the table's angle per record, as unknowns: small steps, and nothing that the table's model has."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, Turntable
from jaxscan.recalibration.adjusted import Start
from jaxscan.recalibration.observed import RoomObservations
from jaxscan.recalibration.settings import RecalibrationSettings


# Standard deviation of the step from the correction of a record to the next: a microstepped motor's errors [rad].
_STEP = 2e-4
# Tolerance within which corrections hold nothing that gain, harmonics and station describe [rad].
_HELD = 1e-6
# Unknown corrections at most; beyond, neighbouring records share one.
_MOST = 4_096
_SIZES = (512, 1_024, 2_048, 4_096)


class Angles(NamedTuple):
    """The angles of all records of all sweeps, one after another, and their unknown corrections."""

    first: Int[np.ndarray, " sweeps"]
    """Where each sweep begins."""
    phi: Float[np.ndarray, " records"]
    """With known faults corrected [rad from home]."""
    known: tuple[Float[np.ndarray, " records"], ...]
    """The known faults of every sweep [rad]."""
    knot: Int[np.ndarray, " records"]
    """The unknown correction of each record; 0 where there are none."""
    smooth: Float[np.ndarray, " knots"]
    held: Float[np.ndarray, "held knots"]


def make_angles(
    observations: RoomObservations, start: Start, scanner: Scanner, settings: RecalibrationSettings
) -> Angles:
    """The angles, and their corrections where the settings ask for one per step."""
    journal = [np.asarray(angle, np.float64) for angle in observations.angles]
    known = start.corrections or tuple(np.zeros(len(angle)) for angle in journal)
    if [len(angle) for angle in journal] != [len(extra) for extra in known]:
        raise CalibrationError("The start's corrections of angles are not of these sweeps: expected one per record.")
    counts = np.array([len(angle) for angle in journal])
    first = np.concatenate([[0], np.cumsum(counts)])[:-1].astype(np.int32)
    corrected = [angle + extra for angle, extra in zip(journal, known, strict=True)]
    phi = np.concatenate(corrected)
    if settings.angles == "model" or not isinstance(scanner.turntable, Turntable):
        return Angles(first, phi, known, np.zeros(len(phi), np.int32), np.zeros(0), np.zeros((0, 0)))
    shared = -(-int(counts.sum()) // _MOST)
    knots = -(-counts // shared)
    begin = np.concatenate([[0], np.cumsum(knots)])
    knot = np.concatenate([begin[k] + np.arange(n) // shared for k, n in enumerate(counts)]).astype(np.int32)
    size = next((size for size in _SIZES if size >= begin[-1]), int(begin[-1]))
    smooth, held = np.zeros(size), np.zeros((6 * len(counts), size))
    for sweep, angle in enumerate(corrected):
        inside = slice(begin[sweep], begin[sweep + 1])
        # Between two sweeps the table may have done anything.
        smooth[begin[sweep] : begin[sweep + 1] - 1] = 1.0 / (_STEP * np.sqrt(shared))
        held[6 * sweep : 6 * sweep + 6, inside] = _described(angle[::shared]).T
    return Angles(first, phi, known, knot, smooth, held)


def _described(phi: Float[np.ndarray, " knots"]) -> Float[np.ndarray, "knots 6"]:
    """Directions of the corrections that gain, harmonics and station describe, each over its tolerance [1 / rad]."""
    shapes = [np.ones_like(phi), phi, np.cos(phi), np.sin(phi), np.cos(2 * phi), np.sin(2 * phi)]
    axes, values, _ = np.linalg.svd(np.stack(shapes, 1) / np.sqrt(len(phi)), full_matrices=False)
    # Over a small part of a turn some of them are the same.
    axes = axes * (values > 1e-6 * values[0])
    held = np.zeros((len(phi), 6))
    held[:, : axes.shape[1]] = axes / (_HELD * np.sqrt(len(phi)))
    return held
