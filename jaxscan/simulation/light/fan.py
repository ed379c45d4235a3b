"""The laser's light across its sheet and along its fan."""

import math

import numpy as np

from jaxscan.simulation.rig import Sheet


_BAND = 5.5
"""Half width of a Gaussian's sampled band, in its standard deviations: beyond it is 3e-7 of the peak."""
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
        power = power * np.maximum(1 + f(spec.uneven_fine) * _ripple(angle / f(math.radians(spec.fine_deg))), 0)
    return power


def _ripple(x: np.ndarray) -> np.ndarray:
    """Smooth noise of variance 1 and of about unit width: waves of different lengths, the same every time."""
    rng = np.random.default_rng(7)
    lengths, phases = rng.uniform(1.5, 8.0, _WAVES), rng.uniform(0, 2 * np.pi, _WAVES)
    total = np.zeros_like(x)
    for length, phase in zip(lengths, phases, strict=True):
        total += np.sin(x * x.dtype.type(2 * np.pi / length) + x.dtype.type(phase))
    return total * x.dtype.type(math.sqrt(2 / _WAVES))
