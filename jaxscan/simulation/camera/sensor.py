"""The sensor: mosaic, shot noise, read noise, response, quantisation, saturation."""

import numpy as np

from jaxscan.simulation.camera.noise import gaussian
from jaxscan.simulation.settings import Colour, PixelFormat, SensorSpec


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
    at 0 and 255. The sensor adds the black level to everything, before the response.

    Args:
        expected: float32, linear light in DN, of any shape.
        sensor: Noise and response.
        rng: Source of the noise.

    Returns:
        uint8 of the same shape.
    """
    codes = np.empty(expected.shape, np.uint8)
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
    np.rint(level, out=level)
    np.clip(level, 0, 255, out=level)
    return level.astype(np.uint8)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear light in DN (0 ... 255) to the DN of the sRGB curve."""
    share = np.clip(linear / np.float32(255), 0, 1)
    curve = np.float32(1.055) * share ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.float32(255) * np.where(share <= 0.0031308, np.float32(12.92) * share, curve)
