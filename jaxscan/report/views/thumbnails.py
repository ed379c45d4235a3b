"""Photographs small enough for a page."""

import numpy as np

from jaxscan.stripes import PixelFormat
from jaxscan.vision import encode_jpeg, to_grey


WIDE_PX = 240
_QUALITY = 70


def thumbnail(frame: np.ndarray, pixel_format: PixelFormat) -> bytes:
    """An image of a camera as a small JPEG.

    Args:
        frame: uint8 [rows, columns(, 3)], as the camera gave it.
        pixel_format: How it is to be read; mosaics become grey.
    """
    image = frame if frame.ndim == 3 else to_grey(frame, pixel_format)
    rows, columns = image.shape[:2]
    step = -(-columns // WIDE_PX)
    whole = image[: rows // step * step, : columns // step * step]
    # The mean of squares of pixels: fine patterns would alias otherwise.
    shape = whole.shape[0] // step, step, whole.shape[1] // step, step, -1
    mean = whole.reshape(shape).astype(np.float32).mean((1, 3))
    brightest = max(float(np.percentile(mean, 99.5)), 1.0)
    shown = np.clip(mean * min(235.0 / brightest, 4.0), 0, 255).astype(np.uint8)
    return encode_jpeg(np.repeat(shown, 3 // shown.shape[2], axis=2), quality=_QUALITY)
