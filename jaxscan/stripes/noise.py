"""Noise of a frame from the frames themselves, by photon transfer."""

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.frames import LaserLine, PixelFormat, Response, decode_table, laser_plane
from jaxscan.stripes.stripes import NoiseModel


_LINE = LaserLine()
_FRAMES = 4
_LINES = 200
"""Lines of a frame that are looked at: enough for 1 % of a variance, in a few milliseconds."""
_STRIPE_SAMPLES = 32
"""Samples on either side of a line's brightest difference that are left out."""
_BINS = np.linspace(0.0, 255.0, 33)
_MIN_COUNT = 200
_DARK_DN = 3.0
"""Below this level the noise is cut off at zero."""
_BRIGHT_DN = 240.0
"""Above this level the noise is cut off at the top."""
_MIN_READ_DN = 0.2
_MIN_SPAN_DN = 10.0
"""Range of levels from which the gain can be told."""
_LAG = 8
"""Distance of the samples that are compared: noise of neighbours is alike in compressed or
demosaiced pictures."""


def estimate_noise(
    on: Array,
    off: Array | None = None,
    *,
    pixel_format: PixelFormat = "mono8",
    response: Response = "linear",
    line: LaserLine = _LINE,
) -> NoiseModel:
    r"""Read noise and conversion gain from pairs of frames.

    Away from the stripe the difference of a pair varies by

    $$\mathrm{var} = 2\,\mathrm{read}^2 + 2\,\mathrm{level}/K + 2/12,$$

    a straight line over the level. Samples a few pixels apart are compared, so that scattered
    light, which is smooth, cancels. Without laser-off frames the second
    difference along a line takes the place of the pair; fine texture then counts as noise.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
        pixel_format: How a frame is to be read.
        response: "linear", or "srgb".
        line: The laser, which says what channel is looked at.

    Returns:
        The model, in linear DN. Where the frames do not tell one of its numbers (all of one
        level, or all dark), that number is the default of `NoiseModel`.

    Source:
        J. R. Janesick, Photon Transfer, 2007, chapter 5.
    """
    chosen = np.unique(np.linspace(0, len(on) - 1, _FRAMES).astype(int))
    planes = [
        np.concatenate([_lines(frames[i : i + 1], pixel_format, line) for i in chosen])
        for frames in ((on,) if off is None else (on, off))
    ]
    table, slope = decode_table(response)
    values = [table[plane] for plane in planes]
    rounding = [slope[plane] ** 2 / 12 for plane in planes]
    if off is None:
        noise, level, quantum = _second_differences(values[0], rounding[0])
    else:
        noise, level, quantum = _pair_differences(values, rounding)
    return _fit_line(*_binned(noise, level, quantum))


def _lines(frames: Array, pixel_format: PixelFormat, line: LaserLine) -> np.ndarray:
    plane = np.asarray(laser_plane(np.asarray(frames), pixel_format=pixel_format, line=line))[0]
    # Whole pairs of lines: the two kinds of lines of a Bayer tile stay balanced.
    stride = max(1, 2 * (len(plane) // (2 * _LINES)) - 1)
    return plane[::stride]


def _pair_differences(values: list[np.ndarray], rounding: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Noise with the variance of a pair's difference, its level, and the part of rounding."""
    difference = values[0] - values[1]
    kept = _off_stripe(difference)
    left, right = slice(None, -_LAG), slice(_LAG, None)
    both = kept[:, left] & kept[:, right]
    noise = (difference[:, right] - difference[:, left]) / np.sqrt(2.0)
    mean, quantum = 0.5 * (values[0] + values[1]), rounding[0] + rounding[1]
    average = lambda a: 0.5 * (a[:, left] + a[:, right])[both]
    return noise[both], average(mean), average(quantum)


def _second_differences(value: np.ndarray, rounding: np.ndarray) -> tuple[np.ndarray, ...]:
    kept = _off_stripe(value)[:, 2:-2]
    noise = (value[:, 1:-3] - 2.0 * value[:, 2:-2] + value[:, 3:-1]) / np.sqrt(3.0)
    # The level from samples that are not in the difference, or noise would choose its level.
    level = 0.5 * (value[:, :-4] + value[:, 4:])
    return noise[kept], level[kept], 2.0 * rounding[:, 2:-2][kept]


def _off_stripe(difference: np.ndarray) -> np.ndarray:
    """True away from each line's brightest place."""
    samples = difference.shape[1]
    width = min(5, samples)
    smooth = np.cumsum(np.pad(difference, ((0, 0), (1, 0))), 1)
    peak = np.argmax(smooth[:, width:] - smooth[:, :-width], 1) + width // 2
    return np.abs(np.arange(samples)[None, :] - peak[:, None]) > _STRIPE_SAMPLES


def _binned(noise: np.ndarray, level: np.ndarray, quantum: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level, variance without rounding, and its standard deviation, for each well filled bin."""
    index = np.digitize(level, _BINS)
    usable = (level > _DARK_DN) & (level < _BRIGHT_DN)
    rows = []
    for i in range(1, len(_BINS)):
        inside = usable & (index == i)
        if np.count_nonzero(inside) < _MIN_COUNT:
            continue
        variance, count = _clipped_variance(noise[inside])
        rows.append((level[inside].mean(), variance - quantum[inside].mean(), np.sqrt(2.0 / count) * variance))
    found = np.array(rows, np.float64).reshape(-1, 3)
    return found[:, 0], found[:, 1], np.maximum(found[:, 2], 1e-3)


def _clipped_variance(noise: np.ndarray) -> tuple[float, int]:
    """Variance of what lies within 4 standard deviations, found by iteration from quantiles."""
    low, middle, high = np.percentile(noise, [15.9, 50.0, 84.1])
    deviation = max(0.5 * (high - low), 0.3)
    for _ in range(5):
        kept = noise[np.abs(noise - middle) <= 4.0 * deviation]
        middle, deviation = kept.mean(), max(kept.std(), 0.1)
    return float(deviation**2), len(kept)


def _fit_line(
    level: Float[np.ndarray, " bins"], variance: Float[np.ndarray, " bins"], sigma: Float[np.ndarray, " bins"]
) -> NoiseModel:
    default = NoiseModel()
    if len(level) == 0:
        return default
    weight = 1.0 / sigma**2
    centre = np.average(level, weights=weight)
    mean = np.average(variance, weights=weight)
    spread = np.sum(weight * (level - centre) ** 2)
    slope = np.sum(weight * (level - centre) * variance) / spread if np.ptp(level) >= _MIN_SPAN_DN else 0.0
    if slope > 0 and slope * np.sqrt(spread) > 5.0:
        gain = 2.0 / slope
    else:
        # One level tells a sum only: keep the default gain, unless it alone explains too much.
        shot = mean - 2.0 * _MIN_READ_DN**2
        gain = max(default.electrons_per_dn, 2.0 * centre / shot) if shot > 0 else 1e6
    read = np.sqrt(max(0.5 * mean - centre / gain, _MIN_READ_DN**2))
    return NoiseModel(read_dn=float(read), electrons_per_dn=float(gain))
