"""Light and sharpness over the field of view: a lens is darker and softer in its corners, and sharp at one distance."""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.camera.optics import blurred_part
from jaxscan.simulation.settings import WIDEST_BLUR_PX, CameraSpec, SimulationConfig


_STEP_PX = 0.12
"""Widths of blur this close are blended: a mixture of two such Gaussians is one of the width between."""
_MOST_WIDTHS = 6
_ROWS, _COLUMNS = 64, 256
"""Of the parts in which pictures are blurred."""


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
        """Share of each width in every pixel; None for the whole."""
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


def softened(image: np.ndarray, blur: Blur) -> np.ndarray:
    """A picture sampled at pixel centres through the lens [..., height, width]: part by part, which stay in the cache.

    Args:
        image: The picture, float32.
        blur: Of its pixels. Each part is blurred only by the widths that it has.
    """
    height, width = image.shape[-2:]
    out = np.empty_like(image)
    step = width if blur.place is None else _COLUMNS
    for top in range(0, height, _ROWS):
        for left in range(0, width, step):
            part = slice(top, min(top + _ROWS, height)), slice(left, min(left + step, width))
            if blur.place is None:
                out[..., *part] = blurred_part(image, blur.widths[0], *part)
                continue
            place = blur.place[part]
            total: np.ndarray = np.zeros((*image.shape[:-2], *place.shape), np.float32)
            # Rounding may put a place a little beyond the last width.
            for k in range(math.floor(place.min()), min(math.ceil(place.max()), len(blur.widths) - 1) + 1):
                share = np.maximum(1 - np.abs(place - np.float32(k)), 0)
                total += blurred_part(image, blur.widths[k], *part) * share
            out[..., *part] = total
    return out


def lens_blur(config: SimulationConfig, depth: np.ndarray) -> Blur:
    """The lens's blur at the surface that every pixel sees.

    Args:
        config: The camera.
        depth: Depth at pixel centres, float32 [height, width]; inf where nothing is.

    No blur is wider than any that `psf_px` may be: the time and memory of rendering grow with it.
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
    """Light behind the lens, from light before it; `index` names the pixels of `values` where these are listed."""
    if shade is None:
        return values
    return values * (shade[tuple(index)][:, None] if index else shade)
