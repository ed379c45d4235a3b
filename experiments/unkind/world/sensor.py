"""Lens blur, speckle and a noisy camera, apart from jaxscan's simulator. Light is in DN above the black level."""

from typing import NamedTuple

import numpy as np
from scipy import fft  # type: ignore[import-untyped]
from scipy.ndimage import gaussian_filter  # type: ignore[import-untyped]


FINE = 4
"""Samples per pixel, in both directions, of the grid on which speckle is drawn."""


class Sensor(NamedTuple):
    """A camera's chip and lens."""

    electrons_per_dn: float = 8.0
    read_dn: float = 1.7
    black_dn: float = 5.0
    blur_px: tuple[float, float] = (0.7, 0.9)
    """Standard deviation of the lens's blur in the middle and in the corners of the image [px]."""
    speckle: float = 0.05
    """Standard deviation over mean of the laser's light on one pixel."""
    pixel_um: float = 3.45
    f_number: float = 4.0
    wavelength_um: float = 0.65

    @property
    def grain_px(self) -> float:
        """Width of a grain of speckle, wavelength times f-number [px]."""
        return self.wavelength_um * self.f_number / self.pixel_um


def blurred(image: np.ndarray, sensor: Sensor, per_pixel: int, part: tuple[slice, int] | None = None) -> np.ndarray:
    """The image behind the lens; it has `per_pixel` samples per pixel in both directions.

    `part` says which columns of pixels it holds, and of how many.
    """
    columns, width = part or (slice(0, image.shape[1] // per_pixel), image.shape[1] // per_pixel)
    x = np.linspace(-1, 1, per_pixel * width)[None, per_pixel * columns.start : per_pixel * columns.stop]
    outer = ((x**2 + np.linspace(-1, 1, len(image))[:, None] ** 2) / 2).astype(np.float32)
    inside, outside = (
        gaussian_filter(image, per_pixel * sigma, mode="nearest", truncate=5.0) for sigma in sensor.blur_px
    )
    return (1 - outer) * inside + outer * outside


class Speckle:
    """Fields of speckle with mean 1, from which every record gets a piece of its own.

    The light on the sensor is the squared magnitude of a circular Gaussian field behind a round aperture. One field has
    a contrast of 1; where a pixel shows less, many independent fields lie on top of one another (wavelengths,
    polarisations, a moving diffuser): their mean has the same grain and a smaller contrast.
    """

    def __init__(self, sensor: Sensor, shape: tuple[int, int], rng: np.random.Generator) -> None:
        """Fields of `shape` [rows, columns] pixels, `FINE` samples each."""
        self.rng = rng
        rows, columns = (fft.next_fast_len(FINE * n) for n in shape)
        fy, fx = np.meshgrid(fft.fftfreq(rows), fft.fftfreq(columns), indexing="ij")
        # The aperture passes frequencies of the field below 1 / (2 grain); grain in samples.
        aperture = np.hypot(fx, fy) < 0.5 / (FINE * sensor.grain_px)
        self.fields = []
        for _ in range(3):
            light = np.zeros((rows, columns), np.float32)
            for _ in range(4):
                noise = rng.standard_normal((2, rows, columns)).astype(np.float32)
                field = fft.ifft2(fft.fft2(noise[0] + 1j * noise[1], workers=2) * aperture, workers=2)
                light += np.abs(field).astype(np.float32) ** 2
            light /= light.mean()
            blocks = light[: rows // FINE * FINE, : columns // FINE * FINE]
            pixels = blocks.reshape(rows // FINE, FINE, columns // FINE, FINE).mean((1, 3))
            light = 1 + (light - 1) * np.float32(sensor.speckle / pixels.std())
            self.fields.append(np.maximum(light, 0.0))

    def draw(self, shape: tuple[int, int]) -> np.ndarray:
        """A piece [rows, columns] of samples, from a random place of a random field."""
        field = self.fields[self.rng.integers(len(self.fields))]
        flipped = field[:: self.rng.choice([-1, 1]), :: self.rng.choice([-1, 1])]
        rows, columns = (
            (int(self.rng.integers(n)) + np.arange(m)) % n for n, m in zip(field.shape, shape, strict=True)
        )
        return flipped[np.ix_(rows, columns)]


def to_pixels(image: np.ndarray, per_pixel: int) -> np.ndarray:
    """Means over pixels of an image with `per_pixel` samples per pixel."""
    rows, columns = (n // per_pixel for n in image.shape)
    return image.reshape(rows, per_pixel, columns, per_pixel).mean((1, 3))


def expose(light: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """A frame, uint8, of the light on every pixel [DN]."""
    electrons = rng.poisson(np.maximum(light, 0.0) * sensor.electrons_per_dn)
    level = electrons / sensor.electrons_per_dn + sensor.black_dn + sensor.read_dn * rng.standard_normal(light.shape)
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def difference_sigma(background: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Standard deviation of a pixel of on minus off beside the stripe [DN], where `background` is light above black."""
    one = sensor.read_dn**2 + 1 / 12 + np.maximum(background, 0.0) / sensor.electrons_per_dn
    return np.sqrt(2 * one)
