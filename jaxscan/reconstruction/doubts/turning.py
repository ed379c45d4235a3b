"""Doubts from the picture's motion: whether the laser-off frames turn as the angles say."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.reconstruction.doubts.outliers import named, scatter
from jaxscan.reconstruction.doubts.seen import Seen


_FEW = 8
_ALIKE = 0.6
"""Correlation from which two frames show the same place [1]."""
_OVERLAP = 0.4
"""Part of the frame that both must show [1]."""
_BINS = 3.0
"""Motion that is never doubted [bins of a trace]."""
_RATIO = (0.55, 1.8)
"""Motion over the calibrated one that near things can explain [1]."""
_AT_ONCE = 256


class Motion(NamedTuple):
    """Motion of the picture from each record to the next."""

    shift: np.ndarray
    """[bins]"""
    alike: np.ndarray
    """Correlation of the two frames after the shift [1]."""


def turning_doubts(seen: Seen, numbers: np.ndarray, angles: np.ndarray, own: np.ndarray, scanner: Scanner) -> list[str]:
    """Records of one laser that show another place than their angle says, and angles that all are wrong.

    Args:
        seen: Of all records.
        numbers: Of all records.
        angles: Of all records [rad].
        own: The records of one laser.
        scanner: The calibrated rig.
    """
    if len(own) < _FEW or not seen.trace[own].any():
        return []
    found = motion(seen.trace[own])
    turned = (np.diff(angles[own]) + np.pi) % (2 * np.pi) - np.pi
    sure = found.alike > _ALIKE
    # Bare walls, wide steps or a dark room tell nothing.
    if np.count_nonzero(sure) < 0.7 * len(sure):
        return []
    moving = sure & (np.abs(turned) > 1e-6)
    if np.count_nonzero(moving) < 0.5 * len(sure):
        return []
    rate = float(np.median(found.shift[moving] / turned[moving]))
    residuals = found.shift - rate * turned
    doubts = []
    far = np.abs(residuals) > max(_BINS, 4.0 * scatter(residuals[sure]))
    off = far | (found.alike < 0.5 * np.median(found.alike))
    if 0 < np.count_nonzero(off) <= 0.4 * len(off):
        # A record that is elsewhere fits neither the one before nor the one after.
        before, after = np.concatenate([off[:1], off]), np.concatenate([off, off[-1:]])
        wrong = np.flatnonzero(before & after)
        if len(wrong) == 0:
            wrong = np.flatnonzero(before)
        doubts.append(f"{named(numbers[own[wrong]])} shows another place than its angle says")
    return doubts + _direction(rate, found, turned, scanner)


def motion(trace: np.ndarray) -> Motion:
    """Motion from each trace to the next, by the correlation of their slopes where both show the same."""
    slopes = np.diff(np.asarray(trace, np.float64), axis=1)
    parts = [_motion(slopes[k : k + _AT_ONCE + 1]) for k in range(0, len(slopes) - 1, _AT_ONCE)]
    return Motion(*(np.concatenate(field) for field in zip(*parts, strict=True)))


def _motion(slopes: np.ndarray) -> Motion:
    one, other = slopes[:-1], slopes[1:]
    count = one.shape[1]
    size = 2 * count
    lags = np.arange(-int((1 - _OVERLAP) * count), int((1 - _OVERLAP) * count) + 1)
    product = np.fft.irfft(np.conj(np.fft.rfft(one, size)) * np.fft.rfft(other, size), size)[:, lags]
    # Only where the two overlap: from max(0, -lag) of the first, and from max(0, lag) of the other.
    energies = [np.pad(np.cumsum(part**2, axis=1), ((0, 0), (1, 0))) for part in (one, other)]
    total = 1e-12
    for energy, sign in zip(energies, (-1, 1), strict=True):
        start, stop = np.maximum(0, sign * lags), count + np.minimum(0, sign * lags)
        part = np.maximum(energy[:, stop] - energy[:, start], 1e-9)
        total = total * part if isinstance(total, np.ndarray) else part
    alike = product / np.sqrt(total)
    best = np.clip(np.argmax(alike, axis=1), 1, len(lags) - 2)
    rows = np.arange(len(one))
    left, top, right = (alike[rows, best + k] for k in (-1, 0, 1))
    curve = left - 2 * top + right
    fine = np.where(curve < -1e-9, 0.5 * (left - right) / np.where(curve < -1e-9, curve, -1.0), 0.0)
    return Motion(lags[best] + np.clip(fine, -0.5, 0.5), top)


def _direction(rate: float, found: Motion, turned: np.ndarray, scanner: Scanner) -> list[str]:
    """Whether the picture moves as a camera that turns with the table sees it."""
    if scanner.turntable.carries != "scanner":
        return []
    camera, table = scanner.camera, scanner.turntable
    upright = scanner.up in ("-v", "+v")
    x, y, _ = np.asarray(table.direction, np.float64)
    gain = float(np.asarray(table.gain))
    per_pixel = len(found.shift) and 159 / ((camera.width if upright else camera.height) - 1)
    expected = gain * per_pixel * float(-np.asarray(camera.fx) * y if upright else np.asarray(camera.fy) * x)
    usual = np.median(np.abs(turned)) * np.array([rate, expected])
    steady = scatter(found.shift - rate * turned) < 0.25 * abs(usual[0])
    if not steady or np.abs(usual).max() < 1.5:
        return []
    ratio = rate / expected
    if _RATIO[0] < ratio < _RATIO[1]:
        return []
    if -_RATIO[1] < ratio < -_RATIO[0]:
        return ["the picture turns against the angles: they may have the wrong sign, or the frames another order"]
    return [f"the picture turns {ratio:.2g} times as far as the angles say: they may be in another unit"]
