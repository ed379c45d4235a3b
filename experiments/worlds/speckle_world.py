"""Stripes of coherent light with known truth: speckle as the aperture makes it, before the pixels integrate it.

Nothing here shares code with the simulator or the extraction under test.
"""

from typing import NamedTuple

import numpy as np
from worlds.stripe_world import Frames, Sensor, expose


_FINE = 4
"""Samples of a pixel in each direction: speckle of f/2.8 has no frequencies beyond their Nyquist limit."""
_MOST_PATTERNS = 25


class Speckle(NamedTuple):
    """The coherent light, and the aperture through which it comes."""

    contrast: float
    """Standard deviation over mean before pixels integrate it [1]: mean of 1 / contrast^2 patterns."""
    f_number: float
    wavelength_um: float = 0.650
    pixel_um: float = 3.45

    @property
    def grain_px(self) -> float:
        """Width of a grain, wavelength / (2 sin u') [px]."""
        return self.wavelength_um * self.f_number / self.pixel_um

    @property
    def limit_px(self) -> float:
        """The uncertainty C wavelength / (2 pi sin u') of Dorsch, Haeusler and Herrmann [px]."""
        return self.contrast * self.grain_px / np.pi


def pattern(shape: tuple[int, int], speckle: Speckle, rng: np.random.Generator) -> np.ndarray:
    """Speckle of mean 1 on a grid of _FINE samples per pixel: a field behind a round aperture."""
    frequency = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1 / _FINE) for n in shape), indexing="ij"))
    inside = frequency <= 0.5 / speckle.grain_px
    total = np.zeros(shape)
    # The mean of many patterns is nearly normal: then the deviations of a few are scaled.
    patterns = min(round(1 / speckle.contrast**2), _MOST_PATTERNS)
    for _ in range(patterns):
        field = np.zeros(shape, np.complex128)
        count = np.count_nonzero(inside)
        field[inside] = rng.standard_normal(count) + 1j * rng.standard_normal(count)
        total += np.abs(np.fft.ifft2(field)) ** 2
    deviation = total / total.mean() - 1.0
    return np.maximum(1.0 + speckle.contrast * np.sqrt(patterns) * deviation, 0.0)


def render_coherent(
    u: np.ndarray,
    width: float,
    amplitude: np.ndarray,
    room: np.ndarray,
    speckle: Speckle | None,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Frames:
    """Pairs of frames with a stripe at `u` [frames, rows], of `amplitude` [rows], in the room's light.

    Args:
        u: Centres [frames, rows]; straight between the middles of rows.
        width: Standard deviation of the stripe [px].
        amplitude: Peak of each row [DN].
        room: Light with the laser off [rows, columns], DN above black.
        speckle: The coherent light; None: incoherent.
        sensor: The sensor; its ambient light is not used.
        rng: Draws.
    """
    rows, columns = room.shape
    fine_row = (np.arange(rows * _FINE) + 0.5) / _FINE - 0.5
    fine_column = (np.arange(columns * _FINE) + 0.5) / _FINE - 0.5
    height = np.interp(fine_row, np.arange(rows), amplitude)
    lit = []
    for centre in u:
        at = np.interp(fine_row, np.arange(rows), centre)
        light = height[:, None] * np.exp(-0.5 * ((fine_column[None, :] - at[:, None]) / width) ** 2)
        if speckle is not None:
            light *= pattern(light.shape, speckle, rng)
        lit.append(light.reshape(rows, _FINE, columns, _FINE).mean((1, 3)))
    on = expose(room + np.stack(lit), sensor, rng)
    off = expose(np.broadcast_to(room, on.shape), sensor, rng)
    return Frames(on, off, u)
