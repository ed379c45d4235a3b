"""Stripes of coherent light with known truth: speckle as the aperture makes it, before the pixels integrate it.

Nothing here shares code with the simulator or the extraction under test.
"""

from typing import NamedTuple

import numpy as np
from scipy.fft import ifft2  # type: ignore[import-untyped]
from worlds.stripe_world import Sensor, expose


_FINE = 4
"""Samples of a pixel in each direction: speckle of f/2.8 has no frequencies beyond their Nyquist limit."""
_HALF_WINDOW = 24
"""Pixels on either side of the middle that the stripe may reach."""


class CoherentFrames(NamedTuple):
    """Pairs of frames uint8 [frames, rows, columns], and the truth [frames, rows]."""

    on: np.ndarray
    off: np.ndarray
    u: np.ndarray
    snr: np.ndarray
    """The laser's light on each row's brightest pixel over the noise of the pair there without it [1]."""


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
    """Speckle of mean 1 on a grid of _FINE samples per pixel: fields behind a round aperture, as many as give it the
    contrast."""
    count = round(1 / speckle.contrast**2)
    frequency = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1 / _FINE) for n in shape), indexing="ij"))
    inside = frequency <= 0.5 / speckle.grain_px
    waves = np.count_nonzero(inside)
    total = np.zeros(shape, np.float32)
    for _ in range(count):
        field = np.zeros(shape, np.complex64)
        field[inside] = rng.standard_normal(waves, np.float32) + 1j * rng.standard_normal(waves, np.float32)
        total += np.abs(ifft2(field)) ** 2
    return total / total.mean()


class Course(NamedTuple):
    """A stripe."""

    u: np.ndarray
    """Centres [frames, rows], within 16 px of the middle of the image; straight between the middles of rows."""
    width: float
    """Standard deviation [px]."""
    amplitude: np.ndarray
    """Peak of each row [DN]."""


def render_coherent(
    stripe: Course, room: np.ndarray, speckle: Speckle, sensor: Sensor, rng: np.random.Generator
) -> CoherentFrames:
    """Pairs of frames with a stripe in the room's light.

    Args:
        stripe: The stripe.
        room: Light with the laser off [rows, columns], DN above black.
        speckle: The coherent light.
        sensor: The sensor; its ambient light is not used.
        rng: Draws.
    """
    rows, columns = room.shape
    fine_row = (np.arange(rows * _FINE) + 0.5) / _FINE - 0.5
    first = columns // 2 - _HALF_WINDOW
    fine_column = first + (np.arange(2 * _HALF_WINDOW * _FINE) + 0.5) / _FINE - 0.5
    height = np.interp(fine_row, np.arange(rows), stripe.amplitude)
    lit = np.zeros((len(stripe.u), rows, columns))
    for frame, centre in zip(lit, stripe.u, strict=True):
        at = np.interp(fine_row, np.arange(rows), centre)
        light = height[:, None] * np.exp(-0.5 * ((fine_column[None, :] - at[:, None]) / stripe.width) ** 2)
        light *= pattern(light.shape, speckle, rng)
        pixels = light.reshape(rows, _FINE, 2 * _HALF_WINDOW, _FINE).mean((1, 3))
        frame[:, first : first + 2 * _HALF_WINDOW] = pixels
    on = expose(room + lit, sensor, rng)
    off = expose(np.broadcast_to(room, on.shape), sensor, rng)
    dark = 2.0 * (sensor.read_dn**2 + 1 / 12 + room / sensor.electrons_per_dn)
    return CoherentFrames(on, off, stripe.u, (lit / np.sqrt(dark)).max(2))
