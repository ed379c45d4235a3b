"""What is given to a writer for one frame: an image, or a list of (image, exposure), and how a record says it."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import MAX_IMAGES


def given_exposures(given: Any, where: str) -> list[float]:
    """The different exposures of a frame [s], ascending; empty for a single image.

    Raises:
        CaptureError: If the list is too long, or what it says is no exposure.
    """
    if not _is_list(given):
        return []
    if not 1 <= len(given) <= MAX_IMAGES:
        raise CaptureError(f"{where}: found a list of {len(given)} images, expected 1 to {MAX_IMAGES}.")
    levels = sorted({float(exposure) for _, exposure in given})
    if not all(math.isfinite(exposure) and 0 < exposure <= 1e6 for exposure in levels):
        raise CaptureError(f"{where}: found the exposures {levels}, expected seconds above 0.")
    return levels


def copies(given: Any | None, shape: tuple[int, ...], where: str) -> list[np.ndarray]:
    """Copies of the images: the caller may reuse its buffers while threads still encode.

    Raises:
        CaptureError: If one is not uint8 of this shape.
    """
    if given is None:
        return []
    images = [np.array(image) for image in ([one for one, _ in given] if _is_list(given) else [given])]
    for image in images:
        if image.dtype != np.uint8 or image.shape != shape:
            raise CaptureError(
                f"{where}: found {image.dtype} with shape {image.shape}, expected uint8 with shape {shape}."
            )
    return images


def unnamed(given: Any | None) -> Any:
    """What stands in a record for these images, their names left open."""
    if given is None:
        return None
    return [{"file": "", "exposure_s": float(exposure)} for _, exposure in given] if _is_list(given) else ""


def named(value: Any, names: Sequence[str]) -> Any:
    """What stands in a record for images, with these names; the other keys of a list stay."""
    if isinstance(value, list):
        return [{**one, "file": name} for one, name in zip(value, names, strict=True)]
    return names[0]


def _is_list(given: Any) -> bool:
    return isinstance(given, list | tuple)
