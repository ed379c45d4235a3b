"""Prepares two frames for comparison: a subset of their lines in linear DN, and their difference."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.stripes import Colour, LaserLine, PixelFormat, Response, decode_table, frame_rank, laser_plane


COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
_LINES = 256
"""Number of lines that are examined; each is independent evidence."""
STACK = 4
"""Most image lines that are averaged to one: this helps faint stripes and harms leaning ones little."""
CLIPPED = 250
"""Lowest level of a clipped pixel [DN]."""
_NEARLY_CLIPPED = 245.0


class FramePair(NamedTuple):
    """The examined lines; each is the mean of some image lines [linear DN]."""

    on: Float[np.ndarray, "lines samples"]
    off: Float[np.ndarray, "lines samples"]
    clipped: float
    """Fraction of clipped pixels, the larger of the two frames."""
    lit: UInt8[np.ndarray, "all samples"]
    """Levels of the laser-on frame."""
    step: int
    """Distance of the examined lines, in image lines."""


def check_frames(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat) -> None:
    """Check type and shape of two frames.

    Raises:
        ValueError: If they are not two frames of the same shape.
    """
    rank = frame_rank(pixel_format)
    if on.dtype != np.uint8 or on.ndim != rank or min(on.shape[:2]) < 64:
        raise ValueError(f"`on` must be uint8 with {rank} dimensions and 64 px, got {on.dtype} with shape {on.shape}.")
    if off.shape != on.shape or off.dtype != np.uint8:
        raise ValueError(f"`off` must be like `on`, got {off.dtype} with shape {off.shape}.")


def with_colour(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, line: LaserLine) -> LaserLine:
    """The laser; for the colour "auto", with the colour that changes most between the frames."""
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
    """The examined lines of two frames, in the laser's colour and along its axis."""
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
    # Where the lines are columns of the image, they are contiguous only from here on.
    return np.ascontiguousarray(total).astype(np.float32) * np.float32(unit / stack)


def difference_of(pair: FramePair, gain: float) -> Float[np.ndarray, "lines samples"]:
    """The laser-on frame minus the light of the room; 0 where that is clipped."""
    room = pair.off * np.float32(gain)
    np.minimum(room, np.float32(255.0), out=room)
    difference = np.subtract(pair.on, room, out=room)
    difference[(pair.off > _NEARLY_CLIPPED) & (difference > 0)] = 0.0
    return difference


def median_of(values: Float[np.ndarray, " n"]) -> float:
    """The median of one or more numbers; without the search for NaN that NumPy's includes, in half of its time."""
    half = values.size // 2
    sorted_about = np.partition(values, half)
    middle = float(sorted_about[half])
    return middle if values.size % 2 else 0.5 * (middle + float(sorted_about[:half].max()))


def gain_of(pair: FramePair) -> float:
    """Lamp ratio of the pair: the median ratio, refined by a robust fit."""
    few = (slice(None, None, max(1, len(pair.on) // 32)), slice(None, None, 3))
    on, off = pair.on[few].ravel(), pair.off[few].ravel()
    # Selected and weighted by the sum: a selection by one frame would be biased by its noise.
    usable = (on + off > 8.0) & (on < CLIPPED) & (off < CLIPPED)
    on, off = on[usable], off[usable]
    if len(on) < 200:
        return 1.0
    gain = float(np.clip(median_of(on / np.maximum(off, 0.25)), 0.1, 10.0))
    both = on + off
    for _ in range(2):
        residual = on - np.float32(gain) * off
        scale = 1.4826 * median_of(np.abs(residual)) + 0.1
        weight = np.maximum(1.0 - (residual / (3.0 * scale)) ** 2, 0.0) ** 2
        bottom = float(np.sum(weight * both * off))
        gain = float(np.sum(weight * both * on)) / bottom if bottom > 0 else gain
    return gain
