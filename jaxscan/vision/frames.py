"""Frames of a camera: what an array must be to be one, its grey, and the bytes in which detectors look."""

import cv2
import numpy as np


_ENDS = 0.5, 99.5
"""Per cent of the pixels that a stretch leaves outside."""
_LEAST_RANGE_DN = 2.0
"""A smaller range shows noise [DN of 8 bits]."""
_TO_GREY = {
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bayer_rggb8": cv2.COLOR_BayerRGGB2GRAY,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2GRAY,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2GRAY,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2GRAY,
}


def check_frame(image: np.ndarray) -> None:
    """Refuse what is no frame.

    Raises:
        ValueError: If it is not uint8 [rows, columns], or RGB [rows, columns, 3], with pixels.
    """
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(
            f"An image must be uint8 [rows, columns] or [rows, columns, 3], got {image.dtype} with shape {image.shape}."
        )
    if image.size == 0:
        raise ValueError(f"An image must have pixels, got shape {image.shape}.")


def to_grey(frame: np.ndarray, pixel_format: str) -> np.ndarray:
    """Convert a frame to [rows, columns] of the same size.

    Returns:
        Of the type of the frame.

    Raises:
        ValueError: If the pixel format is unknown.
    """
    if pixel_format == "mono8":
        return frame
    if pixel_format not in _TO_GREY:
        raise ValueError(f"Unknown pixel format {pixel_format!r}.")
    return np.asarray(cv2.cvtColor(frame, _TO_GREY[pixel_format]), frame.dtype)


def to_bytes(image: np.ndarray) -> np.ndarray:
    """A grey image in which detectors look for things: its own bytes, or those of float levels, stretched.

    Things are found in it, and measured in the image itself: what the ends of the stretch clip would move.
    """
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    low, high = np.percentile(image[::4, ::4], _ENDS)
    scale = 255.0 / max(float(high - low), _LEAST_RANGE_DN)
    return np.clip(np.rint((image - np.float32(low)) * np.float32(scale)), 0, 255).astype(np.uint8)
