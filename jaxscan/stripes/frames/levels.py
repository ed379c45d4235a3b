"""Frames of 10 to 16 bits as levels of 8 bits: each holds the same light in steps four times as fine, and less of it.

A stripe is found in every level, and each line takes the one in which its centre is known best, as of a bracket of
exposures: where the stripe is bright the level of the whole range, where it is faint one whose rounding is far below
the noise. So all that finds stripes works on bytes, whatever the camera gives.
"""

from typing import Literal

import numpy as np
from jaxtyping import UInt8, UInt16

from jaxscan.stripes.frames.formats import PIXEL_FORMATS, PixelFormat


DeepBits = Literal[10, 12, 14, 16]
DEEP_BITS: tuple[DeepBits, ...] = (10, 12, 14, 16)
"""Bits of a sample that can be kept as levels."""
DEEP_FORMATS: dict[str, tuple[PixelFormat, DeepBits]] = {
    f"{lying.removesuffix('8')}{bits}": (lying, bits)
    for lying in PIXEL_FORMATS
    if lying != "rgb8"
    for bits in DEEP_BITS
}
"""Pixel formats of cameras of more than 8 bits, such as "mono12": how their pixels lie, and their bits."""
_STEP_BITS, _MOST = 2, 3
_TOP = 250
_CLIPPED = 255


def level_shifts(bits: int) -> tuple[int, ...]:
    """Bits that each level leaves out, the level of the whole range first.

    Three at most: 4 bits more than 8 are more than a sensor of 14 or 16 bits has below its noise.
    """
    return tuple(shift for shift in range(bits - 8, -1, -_STEP_BITS))[:_MOST]


def level_exposures(bits: int) -> tuple[float, ...]:
    """Relative exposures that the levels stand for, ascending; 1 for the finest steps of the camera."""
    return tuple(2.0**-shift for shift in level_shifts(bits))


def split_levels(frame: UInt16[np.ndarray, "rows columns *rgb"], bits: int) -> list[tuple[np.ndarray, float]]:
    """The levels of a frame, uint8 of its shape, each with its relative exposure.

    Args:
        frame: Samples below 2 ** `bits`.
        bits: One of `DEEP_BITS`.
    """
    return [(_rounded(frame, shift), 2.0**-shift) for shift in level_shifts(bits)]


def join_levels(levels: UInt8[np.ndarray, "levels *frame"], bits: int) -> UInt16[np.ndarray, "*frame"]:
    """The frame that some levels hold, in the finest steps: of each pixel from the finest level that is not clipped.

    Args:
        levels: As of `split_levels`, the level of the whole range first.
        bits: Bits of a sample.

    Returns:
        Samples, of which `finest_steps` are one of a frame of 8 bits.
    """
    shifts = level_shifts(bits)
    joined = levels[0].astype(np.uint16) << (shifts[0] - shifts[-1])
    for level, shift in zip(levels[1:], shifts[1:], strict=True):
        joined = np.where(level < _CLIPPED, level.astype(np.uint16) << (shift - shifts[-1]), joined)
    return joined


def finest_steps(bits: int) -> int:
    """How many of the finest steps that are kept are one step of 8 bits."""
    shifts = level_shifts(bits)
    return 1 << shifts[0] - shifts[-1]


def to_8_bits(frame: UInt16[np.ndarray, "rows columns *rgb"], bits: int) -> UInt8[np.ndarray, "rows columns *rgb"]:
    """A frame in 8 bits: its first level."""
    return _rounded(frame, bits - 8)


def clear_level(frames: UInt8[np.ndarray, "records levels *frame"]) -> int:
    """The level of the finest steps in which most of the picture is not at the top of its range."""
    clear = [k for k in range(frames.shape[1]) if np.median(np.asarray(frames[:, k])[..., ::4, ::4]) < _TOP]
    return max(clear, default=0)


def _rounded(frame: np.ndarray, shift: int) -> np.ndarray:
    # Half a step is added before it is cut off; a sample at the top stays there.
    steps = (frame.astype(np.uint32) + (1 << shift >> 1)) >> shift
    return np.minimum(steps, 255).astype(np.uint8)
