"""Holes of a picture, filled from what is around them."""

import numpy as np
from jaxtyping import Bool, Real


def fill_holes(
    picture: Real[np.ndarray, "height width channels"], known: Bool[np.ndarray, "height width"]
) -> Real[np.ndarray, "height width channels"]:
    """Fill what is not known, smoothly: means of ever larger squares, the smallest that know something.

    Args:
        picture: Any values.
        known: Where they are right; all others are replaced.

    Returns:
        A picture of the same type; zero where nothing is known anywhere.
    """
    if known.all() or not known.any():
        return np.where(known[..., None], picture, 0).astype(picture.dtype)
    weight = known.astype(np.float32)[..., None]
    levels: list[tuple[np.ndarray, np.ndarray]] = [(picture.astype(np.float32) * weight, weight)]
    while max(levels[-1][1].shape[:2]) > 1 and not np.all(levels[-1][1] > 0):
        levels.append((_halved(levels[-1][0]), _halved(levels[-1][1])))
    total, weight = levels[-1]
    coarse = total / np.maximum(weight, 1e-12)
    for total, weight in levels[-2::-1]:
        larger = _doubled(coarse, total.shape[:2])
        coarse = np.where(weight > 0, total / np.maximum(weight, 1e-12), larger)
    if np.issubdtype(picture.dtype, np.integer):
        coarse = np.rint(coarse)
    return np.where(known[..., None], picture, coarse.astype(picture.dtype))


def _halved(part: np.ndarray) -> np.ndarray:
    """Sums of squares of 2 x 2 pixels."""
    rows, columns = part.shape[:2]
    even = np.pad(part, ((0, rows % 2), (0, columns % 2), (0, 0)))
    return even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]


def _doubled(part: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Each pixel as four, smoothed by the pixels beside it."""
    for axis, size in enumerate(shape):
        place = np.clip((np.arange(size) - 0.5) / 2, 0, part.shape[axis] - 1)
        first = np.floor(place).astype(int)
        second = np.minimum(first + 1, part.shape[axis] - 1)
        share = (place - first).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        part = (1 - share) * np.take(part, first, axis) + share * np.take(part, second, axis)
    return part
