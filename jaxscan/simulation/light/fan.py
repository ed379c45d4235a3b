"""The laser's light across its sheet and along its fan."""

import math
from functools import lru_cache

import numpy as np

from jaxscan.simulation.rig import Sheet


_BAND = 5.5
"""Half width of a Gaussian's sampled band, in its standard deviations: beyond it is 3e-7 of the peak."""
_LENGTHS = (1.5, 8.0)
"""Shortest and longest of the waves, in widths of fine changes."""
_PER_WAVE = 600
"""Points of a table on the shortest wave: between them it is right to 2e-5 of its height."""
_MOST_POINTS = 1 << 20
_WAVES = 24
"""Of different lengths, of which fine changes along the line are made."""


def band(sheet: Sheet) -> float:
    """Half width of the band that is lit, in standard deviations of the sheet in the fan's middle."""
    lobes = sheet.spec.lobes_at if any(sheet.spec.side_lobes) else 0.0
    return (_BAND + lobes) * (1 + sheet.spec.widening)


def widened(sheet: Sheet, angle: np.ndarray) -> np.ndarray | np.float32:
    """Factor on the sheet's thickness at an angle in the fan [rad]."""
    if sheet.spec.widening == 0:
        return np.float32(1)
    half = np.float32(math.radians(sheet.spec.fan_deg) / 2)
    return 1 + np.float32(sheet.spec.widening) * np.square(angle / half)


def across(sheet: Sheet, s: np.ndarray) -> np.ndarray:
    """Light at `s` standard deviations beside the sheet; 1 in its middle."""
    f = np.float32
    light = np.exp(f(-0.5) * s * s)
    for share, at in zip(sheet.spec.side_lobes, (-sheet.spec.lobes_at, sheet.spec.lobes_at), strict=True):
        if share > 0:
            light += f(share) * np.exp(f(-0.5) * np.square(s - f(at)))
    return light


def along(sheet: Sheet, angle: np.ndarray) -> np.ndarray:
    """Relative power of the fan at an angle in it [rad]: flat, with soft ends, and as uneven as the laser is."""
    f, spec = np.float32, sheet.spec
    half = f(math.radians(spec.fan_deg) / 2)
    power = np.clip((half - np.abs(angle)) / f(math.radians(2.0)), 0, 1)
    if spec.uneven_slow > 0:
        power = power * (1 + f(spec.uneven_slow) * np.cos(f(5.3) * angle / half + f(0.7)))
    if spec.uneven_fine > 0:
        power = power * np.maximum(1 + f(spec.uneven_fine) * _rippled(spec.fan_deg, spec.fine_deg, angle), 0)
    return power


def _rippled(fan_deg: float, fine_deg: float, angle: np.ndarray) -> np.ndarray:
    """Fine changes along the line; of most lasers between close points of a table."""
    half, points = math.radians(fan_deg) / 2, math.ceil(_PER_WAVE * fan_deg / (_LENGTHS[0] * fine_deg))
    if points > _MOST_POINTS:
        return _ripple(angle / angle.dtype.type(math.radians(fine_deg)))
    table, rise = _ripple_table(fan_deg, fine_deg, points)
    place = (np.clip(angle, -half, half) + half) * (points / (2 * half))
    low = np.minimum(place.astype(np.int32), points - 1)
    return table.take(low) + rise.take(low) * (place - low).astype(np.float32)


@lru_cache(maxsize=8)
def _ripple_table(fan_deg: float, fine_deg: float, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Values at even angles over the fan, and the steps to the next, float32."""
    half = math.radians(fan_deg) / 2
    table = _ripple(np.linspace(-half, half, points + 1) / math.radians(fine_deg))
    return table.astype(np.float32), np.diff(table).astype(np.float32)


def _ripple(x: np.ndarray) -> np.ndarray:
    """Smooth noise of variance 1 and of about unit width: waves of different lengths, the same every time."""
    rng = np.random.default_rng(7)
    lengths, phases = rng.uniform(*_LENGTHS, _WAVES), rng.uniform(0, 2 * np.pi, _WAVES)
    total = np.zeros_like(x)
    for length, phase in zip(lengths, phases, strict=True):
        total += np.sin(x * x.dtype.type(2 * np.pi / length) + x.dtype.type(phase))
    return total * x.dtype.type(math.sqrt(2 / _WAVES))
