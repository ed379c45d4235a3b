"""Two frames made ready to be compared: few lines of each, in linear DN, and what changed between them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.stripes import Colour, LaserLine, PixelFormat, Response, decode_table, frame_rank, laser_plane


COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
_LINES = 256
"""Lines that are looked at; each is evidence of its own."""
STACK = 4
"""Image lines that are added up to one of them at most: a faint line gains, a leaning one loses little."""
CLIPPED = 250
"""Code from which on a pixel is clipped."""
_NEARLY_CLIPPED = 245.0


class FramePair(NamedTuple):
    """The lines that are looked at, in mean DN of the image lines that each is made of."""

    on: Float[np.ndarray, "lines samples"]
    off: Float[np.ndarray, "lines samples"]
    clipped: float
    """Larger part of clipped pixels of the two frames."""
    lit: UInt8[np.ndarray, "all samples"]
    """Codes of the laser-on frame."""
    step: int
    """Image lines from one to the next."""


def check_frames(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat) -> None:
    """Refuse what is no pair of frames.

    Raises:
        ValueError: With what was found.
    """
    rank = frame_rank(pixel_format)
    if on.dtype != np.uint8 or on.ndim != rank or min(on.shape[:2]) < 64:
        raise ValueError(f"`on` must be uint8 with {rank} dimensions and 64 px, got {on.dtype} with shape {on.shape}.")
    if off.shape != on.shape or off.dtype != np.uint8:
        raise ValueError(f"`off` must be like `on`, got {off.dtype} with shape {off.shape}.")


def with_colour(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, line: LaserLine) -> LaserLine:
    """The laser with the colour whose brightest change is greatest."""
    if line.colour != "auto" or pixel_format == "mono8":
        return line
    lines = [LaserLine(line.name, colour, line.stripe_axis) for colour in COLOURS]
    return max(lines, key=lambda one: _brightest_change(on, off, pixel_format, one))


def _brightest_change(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, line: LaserLine) -> float:
    lit, dark = (laser_plane(a[None], pixel_format=pixel_format, line=line)[0, ::4].astype(np.int16) for a in (on, off))
    return float(np.abs(lit - dark).max(1).mean())


def lines_of(
    on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, response: Response, line: LaserLine
) -> FramePair:
    """A few lines of two frames, of the laser's colour and along its axis."""
    lit, dark = (np.asarray(laser_plane(a[None], pixel_format=pixel_format, line=line))[0] for a in (on, off))
    step = max(1, len(lit) // _LINES)
    few = (slice(None, None, 4), slice(None, None, 3))
    clipped = max(float((a[few] >= CLIPPED).mean()) for a in (lit, dark))
    frames = _stacked(lit, step, response), _stacked(dark, step, response)
    return FramePair(*frames, clipped, lit, step)


def _stacked(
    plane: UInt8[np.ndarray, "all samples"], step: int, response: Response
) -> Float[np.ndarray, "lines samples"]:
    """Means of up to `STACK` image lines each [linear DN]."""
    lines, stack = len(plane) // step, min(step, STACK)
    unit = 1.0
    if response != "linear":
        unit = 1.0 / 16.0
        plane = np.rint(16.0 * decode_table(response)[0]).astype(np.uint16)[plane]
    total = plane[: lines * step : step].astype(np.uint16)
    for k in range(1, stack):
        np.add(total, plane[k : lines * step : step], out=total)
    # Where stripes lie across, the lines are columns of the image: in order only from here on.
    return np.ascontiguousarray(total).astype(np.float32) * np.float32(unit / stack)


def difference_of(pair: FramePair, gain: float) -> Float[np.ndarray, "lines samples"]:
    """The laser-on frame without the light of the room; nothing where that is clipped."""
    room = pair.off * np.float32(gain)
    np.minimum(room, np.float32(255.0), out=room)
    difference = np.subtract(pair.on, room, out=room)
    difference[(pair.off > _NEARLY_CLIPPED) & (difference > 0)] = 0.0
    return difference


def gain_of(pair: FramePair) -> float:
    """How much brighter the room is in the laser-on frame: the median, narrowed down on the bulk of the pixels."""
    few = (slice(None, None, max(1, len(pair.on) // 32)), slice(None, None, 3))
    on, off = pair.on[few].ravel(), pair.off[few].ravel()
    # By the sum, and weighted by it: chosen by the noise of one of them, the other would seem darker.
    usable = (on + off > 8.0) & (on < CLIPPED) & (off < CLIPPED)
    on, off = on[usable], off[usable]
    if len(on) < 200:
        return 1.0
    gain = float(np.clip(np.median(on / np.maximum(off, 0.25)), 0.1, 10.0))
    both = on + off
    for _ in range(2):
        residual = on - np.float32(gain) * off
        scale = 1.4826 * float(np.median(np.abs(residual))) + 0.1
        weight = np.maximum(1.0 - (residual / (3.0 * scale)) ** 2, 0.0) ** 2
        bottom = float(np.sum(weight * both * off))
        gain = float(np.sum(weight * both * on)) / bottom if bottom > 0 else gain
    return gain
