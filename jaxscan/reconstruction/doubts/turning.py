"""Doubts from the picture's motion: whether the laser-off frames turn as the angles say."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner, Turntable
from jaxscan.reconstruction.doubts.outliers import said
from jaxscan.reconstruction.doubts.seen import TRACE_BINS, Seen


_FEW = 8
_ALIKE = 0.6
"""Part of the records whose motion must be steady, so that the picture tells anything [1]."""
_OVERLAP = 0.4
"""Part of the frame that both must show [1]."""
_BINS, _NEARER = 3.0, 0.15
"""Motion that is never doubted [bins of a trace], and the part of it that near things add [1]."""
_ELSEWHERE = 0.4
"""Correlation of another place, in that of most neighbours [1]."""
_CONTINUED = 0.6
"""Correlation around records that are elsewhere, in that of most neighbours [1]."""
_STILL = 1e-6
"""Motion of the picture from step to step that is none [bins]."""
_AT_ONCE = 256


class Motion(NamedTuple):
    """Motion of the picture from each record to the next."""

    lags: np.ndarray
    """Motions that were tried [bins]."""
    alike: np.ndarray
    """Correlation of two records after each motion [records - 1, lags]."""


def turning_doubts(seen: Seen, numbers: np.ndarray, angles: np.ndarray, own: np.ndarray, scanner: Scanner) -> list[str]:
    """Records of one laser that show another place than their angle says, and an axis that lies in the image.

    Args:
        seen: Of all records.
        numbers: Of all records.
        angles: Of all records [rad].
        own: The records of one laser.
        scanner: The calibrated rig.
    """
    if len(own) < _FEW or not seen.trace[own].any() or not isinstance(scanner.turntable, Turntable):
        return []
    found = motion(seen.trace[own])
    shift = found.lags[np.argmax(found.alike, axis=1)]
    turned = (np.diff(angles[own]) + np.pi) % (2 * np.pi) - np.pi
    moving = np.abs(turned) > 1e-6
    if not moving.any():
        return []
    rate = float(np.median(shift[moving] / turned[moving]))
    expected = rate * turned
    reach = _BINS + _NEARER * np.abs(expected)
    steady = np.abs(shift - expected) <= reach
    # Bare walls, wide steps or a dark room tell nothing.
    if np.count_nonzero(steady) < _ALIKE * len(steady):
        return []
    near = np.abs(found.lags - expected[:, None]) <= reach[:, None]
    there = np.where(near, found.alike, -1.0).max(1)
    # A record that is elsewhere fits neither the one before nor the one after.
    fits = np.concatenate([[-1.0], there]), np.concatenate([there, [-1.0]])
    misses = np.concatenate([~steady[:1], ~steady]) & np.concatenate([~steady, ~steady[-1:]])
    usual = float(np.median(there))
    wrong = np.flatnonzero(misses & (np.maximum(*fits) < _ELSEWHERE * usual))
    wrong = np.array([k for run in _runs(wrong) if _continues(seen.trace[own], run, expected, usual) for k in run], int)
    doubts = [said(numbers[own[wrong]], "shows", "show") + " another place than the angle says"] if len(wrong) else []
    return doubts + _lying_axis(rate, float(np.median(np.abs(turned))), scanner)


def _runs(wrong: np.ndarray) -> list[np.ndarray]:
    """Records in a row, apart from others."""
    return [run for run in np.split(wrong, np.flatnonzero(np.diff(wrong) > 1) + 1) if len(run)]


def _continues(trace: np.ndarray, run: np.ndarray, expected: np.ndarray, usual: float) -> bool:
    """Whether the picture goes on as expected around a run of records; if not, it tells nothing there (a bare wall).

    Args:
        trace: [records, places, bins]
        run: Records in a row.
        expected: Motion from each record to the next [bins].
        usual: Correlation of most neighbours [1].
    """
    before, after = int(run[0]) - 1, int(run[-1]) + 1
    if before < 0 or after >= len(trace):
        return True
    found = motion(trace[[before, after]])
    there = float(expected[before:after].sum())
    near = np.abs(found.lags - there) <= _BINS + _NEARER * abs(there)
    return bool(near.any() and found.alike[0, near].max() > _CONTINUED * usual)


def motion(trace: np.ndarray) -> Motion:
    """Correlation of the slopes of each record and the next, where both show the same, for every motion.

    Args:
        trace: [records, places, bins]
    """
    slopes = np.diff(np.asarray(trace, np.float32), axis=-1)
    # An edge of a window is not worth more than many of a texture.
    most = float(np.quantile(np.abs(slopes), 0.98)) or 1.0
    slopes = np.clip(slopes, -most, most)
    count = slopes.shape[-1]
    far = int((1 - _OVERLAP) * count)
    lags = np.arange(-far, far + 1)
    starts = range(0, len(slopes) - 1, _AT_ONCE)
    return Motion(lags, np.concatenate([_correlated(slopes[k : k + _AT_ONCE + 1], lags) for k in starts]))


def _correlated(slopes: np.ndarray, lags: np.ndarray) -> np.ndarray:
    count = slopes.shape[-1]
    spectrum = np.fft.rfft(slopes, 2 * count)
    product = np.fft.irfft((np.conj(spectrum[:-1]) * spectrum[1:]).sum(1), 2 * count)[:, lags]
    # The energy of both where they overlap: of the first from max(0, -lag), of the other from max(0, lag).
    energy = np.pad(np.cumsum((slopes**2).sum(1), axis=1), ((0, 0), (1, 0)))
    parts = []
    for own, sign in ((energy[:-1], -1), (energy[1:], 1)):
        start, stop = np.maximum(0, sign * lags), count + np.minimum(0, sign * lags)
        parts.append(np.maximum(own[:, stop] - own[:, start], 1e-9))
    return product / np.sqrt(parts[0] * parts[1])


def _lying_axis(rate: float, turned: float, scanner: Scanner) -> list[str]:
    """Whether the picture moves along an axis by which it cannot; `refuse_other_motion` looks for the other faults.

    Args:
        rate: Motion of the picture [bins/rad].
        turned: Usual step [rad].
        scanner: The calibrated rig.
    """
    camera, table = scanner.camera, scanner.turntable
    if not isinstance(table, Turntable) or table.carries != "scanner":
        return []
    upright = scanner.up in ("-v", "+v")
    x, y, _ = np.asarray(table.direction, np.float64)
    bins = TRACE_BINS / (camera.width if upright else camera.height)
    focal = -np.asarray(camera.fx) * y if upright else np.asarray(camera.fy) * x
    expected = float(np.asarray(table.gain)) * bins * float(focal)
    if turned * abs(rate) < _BINS or turned * abs(expected) >= _STILL:
        return []
    return ["the calibrated axis does not stand upright in the image: the axis, or `up`, may be wrong"]
