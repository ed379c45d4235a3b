"""Frames of a camera: what an array must be to be one, and its grey."""

import cv2
import numpy as np


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
    """Convert a frame to uint8 [rows, columns] of the same size.

    Args:
        frame: uint8 [rows, columns], or RGB [rows, columns, 3] for "rgb8".
        pixel_format: As in a capture.

    Raises:
        ValueError: If the pixel format is unknown.
    """
    if pixel_format == "mono8":
        return frame
    if pixel_format not in _TO_GREY:
        raise ValueError(f"Unknown pixel format {pixel_format!r}.")
    return np.asarray(cv2.cvtColor(frame, _TO_GREY[pixel_format]), np.uint8)
