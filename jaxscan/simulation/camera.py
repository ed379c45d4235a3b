"""The simulated camera: optics, sensor, noise, and pixels that differ."""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.settings import WIDEST_BLUR_PX, CameraSpec, Colour, PixelFormat, SensorSpec, SimulationConfig


_STREAM = 5
"""Key of the random numbers that are drawn from the configuration's seed."""


def flawed(light: np.ndarray, config: SimulationConfig) -> np.ndarray:
    """Light as the camera's pixels count it: times their gain, plus their offset.

    Args:
        light: Linear light in DN, float32 [rows, columns] (rgb8: and 3).
        config: The camera, and the seed of its flaws.
    """
    sensor = config.sensor
    if sensor.gain_spread == sensor.offset_spread_dn == sensor.hot_pixels == 0:
        return light
    gain, offset = _flaws(sensor, light.shape, config.seed)
    return light * gain + offset


@lru_cache(maxsize=4)
def _flaws(sensor: SensorSpec, shape: tuple[int, ...], seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, _STREAM])))
    gain = 1 + np.float32(sensor.gain_spread) * rng.standard_normal(shape, np.float32)
    offset = np.float32(sensor.offset_spread_dn) * rng.standard_normal(shape, np.float32)
    # Dark currents of hot pixels reach over decades.
    hot = rng.random(shape, np.float32) < sensor.hot_pixels
    offset[hot] += np.float32(sensor.hot_dn) * rng.standard_exponential(int(hot.sum()), np.float32)
    return np.maximum(gain, np.float32(0)), offset


# Gaussian noise, several times as fast as by NumPy's ziggurat.
#
# The normal law is cut into 2^16 cells of equal probability, and 16 random bits choose one. A cell stands for the
# number in its middle, except the outermost, where cells are wide: there a number is drawn from the law's tail. So
# every cell that is not drawn is narrower than 0.005 standard deviations, and no number is impossible that the
# generator's 53 bits reach: beyond 8 standard deviations.

_CELLS = 1 << 16
_TAIL = 64
"""Cells at each end in which numbers are drawn."""


def gaussian(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Independent numbers of the normal law of variance 1, float32 of a shape."""
    count = int(np.prod(shape))
    cell = rng.bit_generator.random_raw(-(-count // 4)).view(np.uint16)[:count]
    # Every number of 16 bits is a place in the table: nothing is clipped, and nothing has to be tested.
    noise = _table().take(cell, mode="clip")
    # Addition of 16 bits wraps around, so one comparison finds the cells at both ends.
    outer = np.flatnonzero(cell + np.uint16(_TAIL) < np.uint16(2 * _TAIL))
    beyond = _deviation(np.log(1 - rng.random(len(outer))) + np.log(_TAIL / _CELLS))
    noise[outer] = np.where(cell[outer] < _TAIL, -beyond, beyond)
    return noise.reshape(shape)


@lru_cache(maxsize=1)
def _table() -> np.ndarray:
    """The number in the middle of every cell, float32."""
    half = _deviation(np.log((np.arange(_CELLS // 2) + 0.5) / _CELLS))
    return np.concatenate([-half, half[::-1]]).astype(np.float32)


def _deviation(log_share: np.ndarray) -> np.ndarray:
    """Upper quantile of the normal distribution: the x with log P(X > x) as given, for P up to 1/2."""
    log_beyond, deviation = _tail()
    return np.interp(log_share, log_beyond, deviation)


@lru_cache(maxsize=1)
def _tail() -> tuple[np.ndarray, np.ndarray]:
    """log P(X > x) on an even grid of x from 0, ascending; and the x."""
    # Beyond 12 standard deviations lies 1e-33 of the law, far less than one step of the generator.
    deviation, step = np.linspace(12, 0, 24001, retstep=True)
    density = np.exp(-0.5 * deviation**2)
    pieces = (density[1:] + density[:-1]) * (-0.5 * step) / np.sqrt(2 * np.pi)
    return np.log(np.cumsum(pieces)), deviation[1:]


COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
LUMINANCE = np.array([[0.30], [0.59], [0.11]], np.float32)
"""Levels of red, green and blue light in a mono camera."""
_AT_ONCE = 1 << 15
"""Pixels exposed at a time."""
_SITES = {
    "bayer_rggb8": ((0, 1), (1, 2)),
    "bayer_bggr8": ((2, 1), (1, 0)),
    "bayer_grbg8": ((1, 0), (2, 1)),
    "bayer_gbrg8": ((1, 2), (0, 1)),
}
"""Colour of the four sites of each 2 x 2 block, [row][column]."""


def channels(sensor: SensorSpec) -> np.ndarray:
    """Weights [3, channels] of R, G, B light in the channels that are rendered."""
    return LUMINANCE if sensor.pixel_format == "mono8" else np.eye(3, dtype=np.float32)


def laser_response(sensor: SensorSpec, colour: Colour) -> np.ndarray:
    """Share of the laser's light that each of the channels [channels] sees; a mono camera sees all of it."""
    if sensor.pixel_format == "mono8":
        return np.ones(1, np.float32)
    response = np.full(3, sensor.crosstalk, np.float32)
    response[COLOURS.index(colour)] = 1
    return response


def mosaic(image: np.ndarray, pixel_format: PixelFormat) -> np.ndarray:
    """Light at the sensor's sites from an image [channels, height, width].

    Returns:
        [height, width], or [height, width, 3] for rgb8.
    """
    if pixel_format == "rgb8":
        return np.ascontiguousarray(np.moveaxis(image, 0, -1))
    if pixel_format == "mono8":
        return image[0]
    out = np.empty(image.shape[1:], image.dtype)
    for (row, column), colour in np.ndenumerate(_SITES[pixel_format]):
        out[row::2, column::2] = image[colour, row::2, column::2]
    return out


def expose(expected: np.ndarray, sensor: SensorSpec, rng: np.random.Generator) -> np.ndarray:
    """One exposure of an expected image.

    Shot noise is drawn from the Gaussian with the variance of the Poisson law, which is good
    above about 30 electrons; below, with the usual 40 electrons per DN, less than one DN is at
    stake. Read noise is added, the response is applied, and the result is rounded and clipped
    at 0 and the largest code. The sensor adds the black level to everything, before the response.

    Args:
        expected: float32, linear light in DN, of any shape.
        sensor: Noise and response.
        rng: Source of the noise.

    Returns:
        uint8 of the same shape; uint16 of more than 8 bits.
    """
    codes = np.empty(expected.shape, np.uint8 if sensor.bits == 8 else np.uint16)
    # Some rows at a time, which stay in the processor's cache.
    rows = max(1, _AT_ONCE // max(1, expected[0].size)) if expected.ndim > 1 else max(1, len(expected))
    for start in range(0, len(expected), rows):
        codes[start : start + rows] = _exposed(expected[start : start + rows], sensor, rng)
    return codes


def _exposed(expected: np.ndarray, sensor: SensorSpec, rng: np.random.Generator) -> np.ndarray:
    level = np.maximum(expected, np.float32(0))
    level *= np.float32(1 / sensor.electrons_per_dn)
    level += np.float32(sensor.read_dn**2)
    np.sqrt(level, out=level)
    level *= gaussian(expected.shape, rng)
    level += expected
    level += np.float32(sensor.black_dn)
    if sensor.response == "srgb":
        level = encode_srgb(level)
    elif sensor.response != "linear":
        exponent = np.float32(1 / float(sensor.response.split()[1]))
        level = np.float32(255) * np.clip(level / np.float32(255), 0, 1) ** exponent
    level *= np.float32(1 << sensor.bits - 8)
    np.rint(level, out=level)
    np.clip(level, 0, (1 << sensor.bits) - 1, out=level)
    return level.astype(np.uint8 if sensor.bits == 8 else np.uint16)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear light in DN (0 ... 255) to the DN of the sRGB curve."""
    share = np.clip(linear / np.float32(255), 0, 1)
    curve = np.float32(1.055) * share ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.float32(255) * np.where(share <= 0.0031308, np.float32(12.92) * share, curve)


_STEP_PX = 0.12
"""Widths of blur this close are blended: a mixture of two such Gaussians is one of the width between."""
_MOST_WIDTHS = 6


class Blur(NamedTuple):
    """Width of the lens's blur in every pixel: a place between the listed widths."""

    widths: tuple[float, ...]
    """Standard deviations [px], at even steps of variance."""
    place: np.ndarray | None = None
    """Index into `widths`, with a fraction, float32 [height, width]; None where there is one width."""

    def at(self, *index: np.ndarray | slice) -> "Blur":
        """The blur of some pixels."""
        return self if self.place is None else Blur(self.widths, self.place[index])

    @property
    def widest(self) -> float:
        """The largest standard deviation [px]."""
        return self.widths[-1]

    def shares(self) -> list[np.ndarray | None]:
        """Weight of each width in every pixel; None where the only width has all of it."""
        if self.place is None:
            return [None]
        return [np.maximum(1 - np.abs(self.place - np.float32(k)), 0) for k in range(len(self.widths))]

    def mean(self, weights: np.ndarray) -> float:
        """The width [px] whose variance is the weighted mean of that of all pixels."""
        if self.place is None:
            return self.widths[0]
        low, high = self.widths[0] ** 2, self.widths[-1] ** 2
        place = float((weights * self.place).sum() / weights.sum()) / (len(self.widths) - 1)
        return math.sqrt(low + (high - low) * place)


def blurred(make: Callable[[float], np.ndarray], blur: Blur) -> np.ndarray:
    """An image blurred by widths that differ from pixel to pixel.

    Args:
        make: The image [..., height, width], blurred by one width [px].
        blur: The blur of its pixels.
    """
    if blur.place is None:
        return make(blur.widths[0])
    total: np.ndarray = np.zeros(blur.place.shape, np.float32)
    for width, share in zip(blur.widths, blur.shares(), strict=True):
        total = total + make(width) * share
    return total


def lens_blur(config: SimulationConfig, depth: np.ndarray) -> Blur:
    """The lens's blur at the surface that every pixel sees.

    Args:
        config: The camera.
        depth: Depth at pixel centres, float32 [height, width]; inf where nothing is.

    The blur is limited to the largest allowed `psf_px`, since time and memory grow with it.
    """
    sensor = config.sensor
    if sensor.psf_edge == 0 and sensor.defocus_px_m == 0:
        return Blur((sensor.psf_px,))
    width = sensor.psf_px * (1 + sensor.psf_edge * _radius2(config.camera))
    defocus = sensor.defocus_px_m * np.abs(1 / np.maximum(depth, np.float32(0.05)) - 1 / sensor.focus_m)
    variance = np.minimum(np.square(width) + np.square(defocus), np.float32(WIDEST_BLUR_PX**2))
    low, high = float(variance.min()), float(variance.max())
    steps = int(np.clip(math.ceil((math.sqrt(high) - math.sqrt(low)) / _STEP_PX), 1, _MOST_WIDTHS - 1))
    widths = np.sqrt(np.linspace(low, high, steps + 1))
    place = (variance - low) * (steps / max(high - low, 1e-12))
    return Blur(tuple(map(float, widths)), place.astype(np.float32))


def vignette(config: SimulationConfig) -> np.ndarray | None:
    """Share of the light that arrives in every pixel, float32 [height, width]; None where all does."""
    lost = config.sensor.vignetting
    return None if lost == 0 else (1 - np.float32(lost) * _radius2(config.camera)).astype(np.float32)


@lru_cache(maxsize=4)
def _radius2(camera: CameraSpec) -> np.ndarray:
    """Squared distance from the principal point; 1 in the farthest corner of the image."""
    cx, cy = camera.centre()
    u, v = np.arange(camera.width) - cx, np.arange(camera.height) - cy
    radius2 = u**2 + v[:, None] ** 2
    return (radius2 / radius2.max()).astype(np.float32)


def dimmed(values: np.ndarray, shade: np.ndarray | None, index: Sequence[np.ndarray] = ()) -> np.ndarray:
    """Light after vignetting. Where `values` are listed pixels and not an image, `index` holds their rows and
    columns."""
    if shade is None:
        return values
    return values * (shade[tuple(index)][:, None] if index else shade)


# The lens's blur and the pixels' area: light is spread first, then integrated over pixels.
#
# A stripe drawn by pixel centres, or blurred after it was cut into pixels, locks onto the grid by
# up to 0.3 px. So stripes and boards are sampled finer than pixels. Every sample is spread over the
# pixels around it by the point-spread function, integrated over each pixel.

_ROWS_AT_ONCE = 64
"""Rows that are spread at a time: they stay in the processor's cache."""


def psf_weights(psf_px: float, samples: int) -> np.ndarray:
    """Share of a sample's light that each pixel receives.

    Args:
        psf_px: Standard deviation of the Gaussian point-spread function [px].
        samples: Samples per pixel, at (i + 1/2) / samples - 1/2 of it.

    Returns:
        float32 [2 radius + 1, samples]: the share that goes to the pixel m - radius beside the
        sample's own. Each column has the sum `1 / samples`: light is conserved, and a uniform
        field of value 1 gives 1.
    """
    radius = max(1, math.ceil(4 * psf_px))
    at = (np.arange(samples) + 0.5) / samples - 0.5
    fine = 32
    within = (np.arange(fine) + 0.5) / fine - 0.5
    pixels = np.arange(-radius, radius + 1)
    distance = pixels[:, None, None] + within[None, :, None] - at[None, None, :]
    weights = np.exp(-0.5 * (distance / psf_px) ** 2).sum(1)
    return (weights / weights.sum(0) / samples).astype(np.float32)


def splat(
    values: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    weights_v: np.ndarray,
    weights_u: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """Image of samples given for some of the pixels only.

    Args:
        values: [pixels, samples_v * samples_u] light of the samples of each listed pixel.
        rows: Row of each listed pixel.
        columns: Column of each.
        weights_v: `psf_weights` along v, [2 radius + 1, samples_v].
        weights_u: The same along u.
        shape: Height and width of the image.

    Returns:
        float32 [height, width].
    """
    count_v, count_u = weights_v.shape[1], weights_u.shape[1]
    lit = np.flatnonzero(values.any(1))
    if len(lit) == 0:
        return np.zeros(shape, np.float32)
    light, rows, columns = values[lit].reshape(-1, count_v, count_u), rows[lit], columns[lit]
    if count_v > count_u:
        return _splat(light.swapaxes(1, 2), columns, rows, weights_u, weights_v, shape[::-1]).T.copy()
    return _splat(light, rows, columns, weights_v, weights_u, shape)


def _splat(
    light: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    weights_v: np.ndarray,
    weights_u: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """Like `splat`, for light [pixels, samples_v, samples_u]: spread along u for each listed pixel, then along v as
    whole images, over the lit rows and columns only.
    """
    reach_v, reach_u = len(weights_v) // 2, len(weights_u) // 2
    top, left = int(rows.min()), int(columns.min())
    height, width = int(rows.max()) - top + 1, int(columns.max()) - left + 1 + 2 * reach_u
    spread = np.einsum("pij,nj->ipn", light.astype(np.float32), weights_u)
    places = (((rows - top) * width + columns - left)[:, None] + np.arange(len(weights_u))).ravel()
    image = np.zeros((height + 2 * reach_v, width), np.float32)
    for part, shares in zip(spread, weights_v.T, strict=True):
        sums = np.bincount(places, weights=part.ravel(), minlength=height * width)
        plane = sums.astype(np.float32).reshape(height, width)
        for start in range(0, height, _ROWS_AT_ONCE):
            some = plane[start : start + _ROWS_AT_ONCE]
            for m, share in enumerate(shares):
                image[start + m : start + m + len(some)] += some * share
    out = np.zeros(shape, np.float32)
    # Light that falls beside the sensor is lost.
    first_row, first_column = max(top - reach_v, 0), max(left - reach_u, 0)
    stop_row, stop_column = min(top + height + reach_v, shape[0]), min(left + width - reach_u, shape[1])
    out[first_row:stop_row, first_column:stop_column] = image[
        first_row - top + reach_v : stop_row - top + reach_v,
        first_column - left + reach_u : stop_column - left + reach_u,
    ]
    return out


def integrate(samples: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Image of a whole block of samples.

    Args:
        samples: float32 [n_u, n_v, rows + 2 radius, columns + 2 radius]: the same sample of all
            pixels lies together.
        weights: `psf_weights` [2 radius + 1, n], with n_u = n_v = n.

    Returns:
        float32 [rows, columns].
    """
    # Weight taps - 1 - k is the share that pixel 0 receives from the pixel k - radius beside it.
    kernel = weights[::-1]
    return _weighted_sum(_weighted_sum(samples, kernel, axis=-1), kernel, axis=-2)


def _weighted_sum(samples: np.ndarray, kernel: np.ndarray, *, axis: int) -> np.ndarray:
    """Sum over taps k and samples m of kernel[k, m] times samples[m] shifted by k along u (-1) or v (-2).

    Plain multiply and add on arrays that fit the cache: a BLAS call here is a product with a
    4 x 7 matrix, and its threads get in the way of those that render other frames.
    """
    size = samples.shape[axis] - len(kernel) + 1
    parts = [samples[..., k : k + size] if axis == -1 else samples[..., k : k + size, :] for k in range(len(kernel))]
    out = np.zeros(parts[0].shape[1:], np.float32)
    product = np.empty_like(out)
    for part, row in zip(parts, kernel, strict=True):
        for sample, weight in zip(part, row, strict=True):
            np.multiply(sample, weight, out=product)
            out += product
    return out


def blur(image: np.ndarray, psf_px: float) -> np.ndarray:
    """A picture sampled at pixel centres, blurred by lens and pixel [..., height, width].

    Good enough for the room in its own light, which is looked at but not measured. Binomial
    passes (a, 1 - 2a, a) of the same variance, psf^2 + 1/12, stand for the Gaussian.
    """
    passes, a = _passes(psf_px)
    for _ in range(passes):
        image = _binomial(_binomial(image, a).swapaxes(-1, -2), a).swapaxes(-1, -2)
    return image


def _passes(psf_px: float) -> tuple[int, np.float32]:
    """How many binomial passes make a blur, and the share of each that goes to a neighbour."""
    variance = psf_px**2 + 1 / 12
    passes = math.ceil(variance / 0.6)
    return passes, np.float32(variance / passes / 2)


def _binomial(image: np.ndarray, a: np.float32) -> np.ndarray:
    """(a, 1 - 2a, a) down the columns; border pixels are repeated beyond the border."""
    out, aside = image * (1 - 2 * a), image * a
    out[..., 1:, :] += aside[..., :-1, :]
    out[..., :-1, :] += aside[..., 1:, :]
    out[..., 0, :] += aside[..., 0, :]
    out[..., -1, :] += aside[..., -1, :]
    return out
