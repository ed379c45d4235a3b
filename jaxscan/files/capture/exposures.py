"""Several images for one frame: repetitions of an exposure are averaged, different exposures are a bracket."""

from collections.abc import Callable, Sequence

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.journal import Record
from jaxscan.files.capture.references import ImageRef
from jaxscan.stripes import level_exposures


Load = Callable[[ImageRef, np.ndarray | None], np.ndarray]


def exposure_levels(images: Sequence[ImageRef]) -> tuple[float, ...]:
    """The different exposures of a frame [s], ascending; empty where the record names none."""
    return tuple(sorted({one.exposure_s for one in images if one.exposure_s is not None}))


def check_exposures(records: Sequence[Record], *, name: str, bits: int | None = None) -> None:
    """Check that all frames of a sweep have the same exposures.

    Args:
        records: All records of the sweep.
        name: Name of the journal, for messages.
        bits: Bits of a sample, where frames are kept as levels.

    Raises:
        CaptureError: With the first record that differs from the first one, or in itself; or if they are not the levels
            of so many bits.
    """
    expected = exposure_levels(records[0].on)
    if bits is not None and not np.array_equal(expected, level_exposures(bits)):
        raise CaptureError(
            f"{name}: record {records[0].i}: found {_levels(expected)}, but the header has bits = {bits}: expected the "
            f"relative exposures {', '.join(f'{one:g}' for one in level_exposures(bits))} of its levels."
        )
    for record in records:
        for side, images in (("on", record.on), ("off", record.off)):
            if images and exposure_levels(images) != expected:
                raise CaptureError(
                    f"{name}: record {record.i}: {side}: found {_levels(exposure_levels(images))}, but the sweep began "
                    f"with {_levels(expected)}; all frames of a sweep need the same exposures."
                )


def load_levels(images: Sequence[ImageRef], target: np.ndarray, load: Load) -> None:
    """Read a frame, exposures ascending, and average repetitions.

    Args:
        images: Images of the frame.
        target: uint8 [exposures, rows, columns(, 3)], filled.
        load: Reads one image, into the memory that it is given or elsewhere.
    """
    levels = exposure_levels(images)
    for row, level in zip(target, levels, strict=True) if levels else [(target[0], None)]:
        average([one for one in images if one.exposure_s == level], row, load)


def average(images: Sequence[ImageRef], target: np.ndarray, load: Load) -> None:
    """The mean of images, rounded to whole DN, halves to even so that the rounding has no bias.

    Args:
        images: One or more.
        target: uint8 [rows, columns(, 3)], filled.
        load: Reads one image, into the memory that it is given or elsewhere.
    """
    if len(images) == 1:
        found = load(images[0], target)
        if found is not target:
            target[...] = found
        return
    # The sum of 16 images of 255 DN fits; in float32 the mean is exact where it is a half.
    total = np.zeros(target.shape, np.uint16)
    for one in images:
        total += load(one, None)
    target[...] = np.rint(total / np.float32(len(images)))


def _levels(levels: Sequence[float]) -> str:
    return "one image without exposure" if not levels else ", ".join(f"{1e3 * level:g}" for level in levels) + " ms"
