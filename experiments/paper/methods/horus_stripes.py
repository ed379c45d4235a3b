"""The stripe finder of the best-known desk scanner, Horus, written from facts about it; nothing is copied."""

import cv2
import numpy as np


SCAN, CALIBRATION = 50, 30
"""Its thresholds, fixed, in 8-bit codes."""
TUNED = 15
"""About three standard deviations of a pixel of the difference [DN]."""
REACH = 8
"""Half of the window of its centroid [px]."""
SMOOTHING = 2.0
"""Standard deviation of its smoothing along the stripe [rows]."""


def centres(on: np.ndarray, off: np.ndarray, threshold: int = SCAN) -> tuple[np.ndarray, np.ndarray]:
    """Centroids of one frame: 8-bit difference, threshold, box of 5 x 5, threshold again, 8 px round the highest pixel.

    Args:
        on: uint8 [rows, columns].
        off: The same with the laser off.
        threshold: Of the difference, before and after the blur [DN].

    Returns:
        u: Column, float32 [rows]; of no meaning where not valid.
        valid: bool [rows].
    """
    image = cv2.subtract(on, off)
    cv2.threshold(image, threshold, 255, cv2.THRESH_TOZERO, dst=image)
    cv2.blur(image, (5, 5), dst=image)
    cv2.threshold(image, threshold, 255, cv2.THRESH_TOZERO, dst=image)
    return centroid(image, image.argmax(axis=1), REACH, 0)


def centroid(image: np.ndarray, peak: np.ndarray, reach: int, least: int) -> tuple[np.ndarray, np.ndarray]:
    """Centre of gravity of each row within `reach` columns of its peak [rows], of pixels of at least `least`."""
    columns = peak[:, None] + np.arange(-reach, reach + 1)
    inside = (columns >= 0) & (columns < image.shape[1])
    window = image[np.arange(len(image))[:, None], np.clip(columns, 0, image.shape[1] - 1)].astype(np.float32)
    window[(window < least) | ~inside] = 0
    total = window.sum(1)
    return (window * columns).sum(1) / np.maximum(total, 1.0), total > 0


def smoothed(u: np.ndarray, valid: np.ndarray, sigma: float = SMOOTHING) -> np.ndarray:
    """Columns [rows] smoothed by a Gaussian along each unbroken segment, whose ends count as if they went on."""
    out = u.astype(np.float64)
    reach = int(4 * sigma + 0.5)
    steps = np.arange(-reach, reach + 1)
    weight = np.exp(-0.5 * (steps / sigma) ** 2)
    weight /= weight.sum()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(np.int8), [0]])))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        padded = np.pad(out[first:stop], reach, mode="symmetric")
        out[first:stop] = np.convolve(padded, weight, mode="valid")
    return out


def scan(on: np.ndarray, off: np.ndarray, threshold: int = SCAN) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed centroids of a frame, or of several [records, rows, columns]: float64 and bool [(records,) rows]."""
    if on.ndim == 3:
        u, valid = zip(*(scan(*pair, threshold) for pair in zip(on, off, strict=True)), strict=True)
        return np.stack(u), np.stack(valid)
    u, valid = centres(on, off, threshold)
    return np.where(valid, smoothed(u, valid), 0.0), valid


def tuned(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`scan` with a threshold low enough for far walls.

    Args:
        on: Laser-on frames, uint8 [rows, columns] or [records, rows, columns].
        off: Laser-off frames of the same shape.

    Returns:
        u: Column, float64 [(records,) rows]; zero where not valid.
        valid: bool of the same shape.
    """
    return scan(on, off, TUNED)
