"""Conversion of frames of any pixel format to grey."""

import cv2
import numpy as np


_TO_GREY = {
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bayer_rggb8": cv2.COLOR_BayerRGGB2GRAY,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2GRAY,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2GRAY,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2GRAY,
}


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
