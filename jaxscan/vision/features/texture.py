"""Corners of a texture that stand out of the noise, and whether a room has enough of them."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.geometry import median_sigma


_BLOCK = 11
"""Side of the window over which gradients are summed [px]."""
_LARGEST_SIGMA = 0.12
"""A feature is followed if noise alone moves it by less than this [px]."""
_LEAST_NOISE = 0.4
"""Noise of an image, at least [DN]: rounding, and changes with the view."""
_FEWEST, _CELLS, _FEWEST_CELLS = 40, (4, 4), 5
"""Features of an image, and cells of a grid over it that have some, at least."""
_LEAST_SIDE = 64
_SEARCHED_PIXELS = 900_000
"""Of an image in which features are looked for, at most."""


class Corners(NamedTuple):
    """Places of features in an image, best first."""

    x: np.ndarray
    """Whole column and row [n, 2], px."""
    sigma: np.ndarray
    """Standard deviation of a coordinate by the image's noise alone [px]."""


def image_noise(image: np.ndarray) -> float:
    """Noise of an image [DN], from the Laplacian's median: texture fills less than half of it.

    Source: Immerkær, Fast noise variance estimation, Computer Vision and Image Understanding 64 (1996).
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    laplacian = cv2.filter2D(image, cv2.CV_32F, kernel)[1:-1:3, 1:-1:3]
    return max(median_sigma(laplacian) / 6.0, _LEAST_NOISE)


def find_features(image: np.ndarray, sees: np.ndarray, taken: np.ndarray, apart: int, most: int) -> Corners:
    """The best features of an image that lie apart from one another.

    A large image is reduced before: features are large too, and those that are not are many.
    """
    factor = int(np.ceil(np.sqrt(image.size / _SEARCHED_PIXELS)))
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    cut = image[: rows * factor, : columns * factor]
    small = cut if factor == 1 else np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
    noise = image_noise(small)
    # cornerMinEigenVal divides the derivatives of a uint8 image by 255 * 4 * block; those of a ramp of one grey level
    # per pixel are 8 before that.
    unit = (255.0 * 4.0 * _BLOCK / 8.0) ** 2
    # The noise of the gradients must not count as texture.
    weakest = cv2.cornerMinEigenVal(small, _BLOCK, ksize=3) * unit - 12 / 64 * (_BLOCK * noise) ** 2
    around = np.ones((2 * (apart // factor) + 1,) * 2, np.uint8)
    near = np.zeros(small.shape, np.uint8)
    near[np.minimum(taken[:, 1] // factor, rows - 1), np.minimum(taken[:, 0] // factor, columns - 1)] = 1
    middle = factor // 2
    peak = (weakest > (noise / _LARGEST_SIGMA) ** 2) & (weakest >= cv2.dilate(weakest, around))
    peak &= (sees[middle::factor, middle::factor][:rows, :columns] > 0) & (cv2.dilate(near, around) == 0)
    v, u = np.nonzero(peak)
    best = np.argsort(-weakest[v, u], kind="stable")[:most]
    x = np.stack([u[best], v[best]], -1) * factor + middle
    return Corners(x, noise / np.sqrt(weakest[v[best], u[best]]) * factor)


def enough_texture(images: Sequence[np.ndarray]) -> tuple[bool, str]:
    """Whether features can be followed through such images.

    Returns:
        enough: Whether most of them have features in most parts.
        reason: The numbers, in a few words.
    """
    usable = [image for image in images if min(image.shape) >= _LEAST_SIDE]
    if not usable:
        return False, "no image is large enough"
    counts = [_count(image) for image in usable]
    number = int(np.median([count for count, _ in counts]))
    cells = int(np.median([cell for _, cell in counts]))
    if number < _FEWEST:
        return False, f"{number} features in an image, expected at least {_FEWEST}"
    if cells < _FEWEST_CELLS:
        parts = _CELLS[0] * _CELLS[1]
        return False, f"features in {cells} of {parts} parts of an image, expected at least {_FEWEST_CELLS}"
    return True, f"{number} features in an image"


def _count(image: np.ndarray) -> tuple[int, int]:
    """Features of one image, and cells of a grid that have some."""
    rows, columns = image.shape
    everywhere, none = np.full(image.shape, 255, np.uint8), np.zeros((0, 2), int)
    found = find_features(image, everywhere, none, max(4, min(image.shape) // 60), 2000)
    cell = found.x[:, 1] * _CELLS[1] // rows * _CELLS[0] + found.x[:, 0] * _CELLS[0] // columns
    return len(found.x), len(np.unique(cell))
