"""Speckle: a coherent laser's light on a rough surface, through the lens.

Within the lens's resolution the waves of many points of the surface add up at random. The field on the sensor
is circular Gaussian noise that the aperture passes up to the frequency 1 / (2 lambda N) (N: f-number); its
intensity is fully developed speckle: contrast 1, correlated over about lambda N.

The pattern multiplies the laser's irradiance behind the lens on a grid finer than a grain; pixels integrate the
product. So contrast on a pixel, correlation of neighbours and error of a centre follow from wavelength, aperture
and pixel alone. Sources: J. W. Goodman, "Speckle Phenomena in Optics", 2007, chapters 2 and 4; R. G. Dorsch,
G. Haeusler, J. M. Herrmann, "Laser triangulation: fundamental uncertainty in distance measurement", 1994.
"""

import math
from functools import lru_cache

import numpy as np

from jaxscan.simulation.light.stripe import LitSamples


CORE = 16
"""Side of the square parts of the image that are drawn at a time [px]; the pattern has a seam between them."""
MOST_PATTERNS = 4
_BATCH = 8
_FAINT = 0.01
"""Light that is too faint for its speckle to matter [DN]."""


def speckle_light(samples: LitSamples, grain: float, contrast: float, rng: np.random.Generator) -> np.ndarray:
    """The light that speckle adds on every pixel; its mean is 0.

    Args:
        samples: The laser's light before the lens.
        grain: lambda N [px].
        contrast: Standard deviation over mean of the pattern in a point: 1 for polarised light from a surface
            that keeps the polarisation. Less is the mean of 1 / contrast^2 patterns; below 0.5 it is four
            patterns and an even share.
        rng: Source of the pattern.

    Returns:
        float32 [height, width], DN.
    """
    height, width = samples.shape
    fine = int(np.clip(math.ceil(3 / grain), 4, 32))
    reach = max(1, math.ceil(4 * samples.blur.widest))
    rows, columns = -(-height // CORE), -(-width // CORE)
    total = np.zeros((rows, CORE, columns, CORE), np.float32)
    # Places of pixels in the list of lit ones; all others read the line of zeros at its end.
    place = np.full((rows * CORE + 2 * reach, columns * CORE + 2 * reach), len(samples.light))
    place[samples.rows + reach, samples.columns + reach] = np.arange(len(samples.light))
    light = np.append(samples.light, np.zeros((1, samples.light.shape[1]), np.float32), 0)
    windows = np.lib.stride_tricks.sliding_window_view(place, (CORE + 2 * reach,) * 2)[::CORE, ::CORE]
    level = samples.light.mean(1)
    bright = np.append(level > _FAINT, False)
    tiles = np.argwhere(bright[windows].any((2, 3)))
    for start in range(0, len(tiles), _BATCH):
        i, j = tiles[start : start + _BATCH].T
        seen = windows[i, j]
        lit = seen[seen < len(level)]
        psf_px = round(samples.blur.at(lit).mean(level[lit]), 2)
        lens_v, lens_u = (_lens(psf_px, count, fine, reach) for count in samples.counts)
        part = light[seen].reshape(len(i), *(CORE + 2 * reach,) * 2, *samples.counts)
        part = part.transpose(0, 1, 3, 2, 4).reshape(len(i), *((CORE + 2 * reach) * n for n in samples.counts))
        # Not by matrix products: their threads get in the way of those that render other frames.
        product = np.einsum("ai,bio->bao", lens_v, np.einsum("bij,oj->bio", part, lens_u))
        product *= _pattern(len(i), fine, grain, contrast, rng)
        total[i, :, j] = product.reshape(len(i), CORE, fine, CORE, fine).mean((2, 4))
    return total.reshape(rows * CORE, columns * CORE)[:height, :width]


@lru_cache(maxsize=64)
def _lens(psf_px: float, samples: int, fine: int, reach: int) -> np.ndarray:
    """Light at the points of the fine grid of a part from the samples of its pixels and those around, one axis."""
    # A blur narrower than the samples are apart would leave points without light.
    psf_px = max(psf_px, 0.5 / samples)
    at = (np.arange((CORE + 2 * reach) * samples) + 0.5) / samples - reach
    points = (np.arange(CORE * fine) + 0.5) / fine
    # Beyond eight deviations lie numbers that processors are slow with.
    weights = np.exp(-0.5 * ((points[:, None] - at) / psf_px) ** 2)
    weights[weights < 1e-14] = 0
    return (weights / weights.sum(1, keepdims=True)).astype(np.float32)


def _pattern(count: int, fine: int, grain: float, contrast: float, rng: np.random.Generator) -> np.ndarray:
    """Deviation of speckle from its mean 1 on the fine grid of some parts, float32 [count, side, side]."""
    # The discrete spectrum makes the pattern repeat, well beyond the part that is used.
    period = CORE + math.ceil(8 * grain)
    k = np.fft.fftfreq(period * fine, 1 / (period * fine))
    pupil = np.hypot(k[:, None], k) <= period / (2 * grain)
    patterns = max(1, min(MOST_PATTERNS, math.floor(1 / contrast**2 + 1e-6)))
    side, passed, open_rows = CORE * fine, int(pupil.sum()), np.flatnonzero(pupil.any(1))
    total = np.zeros((count, side, side), np.float32)
    for _ in range(patterns):
        waves = np.zeros((count, len(open_rows), len(k)), np.complex64)
        waves[:, pupil[open_rows]] = rng.standard_normal((count, passed, 2), np.float32).view(np.complex64)[..., 0]
        # Only rows that the pupil passes are transformed, and only columns that are used.
        across = np.zeros((count, len(k), side), np.complex64)
        across[:, open_rows] = np.fft.ifft(waves, norm="forward")[:, :, :side]
        field = np.fft.ifft(across, axis=1, norm="forward")[:, :side]
        total += field.real**2 + field.imag**2
    total *= np.float32(1 / (2 * passed * patterns))
    total -= 1
    total *= np.float32(contrast * math.sqrt(patterns))
    return total
