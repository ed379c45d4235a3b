"""Frames as they are given to a writer: one image, or a list of (image, exposure)."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import MAX_IMAGES
from jaxscan.stripes import split_levels


class GivenFrame(NamedTuple):
    """A frame, checked and copied."""

    images: list[np.ndarray]
    """Copies: the caller may reuse its buffers while threads still encode."""
    entry: Any
    """Its entry in the record, without the names of the files; None without a frame."""
    levels: list[float]
    """The different exposures [s], ascending; empty for a single image."""


def given_frame(given: Any | None, shape: tuple[int, ...], where: str, bits: int | None = None) -> GivenFrame:
    """A frame of a record; None without one. With `bits`, one of uint16 is kept as its levels.

    Raises:
        CaptureError: If the list is too long, an exposure is not a positive number, or an image is not uint8
            of this shape.
    """
    if given is None:
        return GivenFrame([], None, [])
    if bits is not None:
        if not isinstance(given, np.ndarray) or given.dtype != np.uint16:
            raise CaptureError(f"{where}: expected one frame, uint16, for the header has bits = {bits}.")
        given = split_levels(given, bits)
    entry: Any = ""
    levels: list[float] = []
    if isinstance(given, list | tuple):
        if not 1 <= len(given) <= MAX_IMAGES:
            raise CaptureError(f"{where}: found a list of {len(given)} images, expected 1 to {MAX_IMAGES}.")
        entry = [{"file": "", "exposure_s": float(exposure)} for _, exposure in given]
        levels = sorted({one["exposure_s"] for one in entry})
        if not all(math.isfinite(exposure) and 0 < exposure <= 1e6 for exposure in levels):
            raise CaptureError(f"{where}: found the exposures {levels}, expected seconds above 0.")
        images = [np.array(image) for image, _ in given]
    else:
        images = [np.array(given)]
    for image in images:
        if image.dtype != np.uint8 or image.shape != shape:
            raise CaptureError(
                f"{where}: found {image.dtype} with shape {image.shape}, expected uint8 with shape {shape}."
            )
    return GivenFrame(images, entry, levels)


def named(entry: Any, names: Sequence[str]) -> Any:
    """The entry of a frame with the names of its files; other keys of a list stay."""
    if isinstance(entry, list):
        return [{**one, "file": name} for one, name in zip(entry, names, strict=True)]
    return names[0]
