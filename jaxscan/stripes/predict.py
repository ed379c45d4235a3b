r"""The laser-off frame that a laser-on frame speaks of.

Along the line: the running median, which a stripe does not raise.

Colour: a surface's hue changes less along a line than its brightness does. With M the mixture of the other channels
that is most like the laser's channel L away from all stripes, the prediction is $M \cdot \mathrm{median}(L / M)$, with
the running median along the line. Where the laser's channel is clipped, the others see the laser too: there M is its
own running median.

Of several predictions each place takes the one that its surroundings bear out, and what is left of the median of the
difference is added, so that the prediction is right on average around every stripe.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.ndimage  # type: ignore[import-untyped]
from jaxtyping import Bool, Float, Int16, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Colour, LaserLine, PixelFormat, laser_plane, laser_sites


_CODES = 1024
"""Values of which medians are taken are whole numbers from 0 to below this."""
_HALF_PX = 32
"""Reach on either side of the running medians of hue and of clipped stripes [px]."""
_NEAR_PX = 12
"""Reach of the median of what is left [px]: stripes up to as wide as this do not raise it."""
_AROUND = 4
"""Lines on either side whose residuals choose among predictions."""
_PER_OCTAVE = 128
"""Steps of a ratio by which it doubles: 0.3 % of rounding."""
_SOFT_DN = 4.0
"""Added to both levels of a ratio, which noise would rule in the dark [DN]."""
_MOST_DN = 24.0
"""Residual from which more is not worse: that of a stripe [DN]."""
_CLIPPED = 254
_LATTICE = 10_000
"""Pixels of a frame from which the mixture is learned."""
_STEPS = 12

Planes = Float[np.ndarray, "frames lines samples"]
_COLOURS: tuple[Colour, ...] = ("red", "green", "blue")


class Channels(NamedTuple):
    """Planes of a chunk of frames on the pixels of the laser's channel."""

    laser: UInt8[np.ndarray, "frames lines samples"]
    """Level of the laser's channel [DN]."""
    others: tuple[Float[np.ndarray, "frames lines samples"], ...]
    """Levels of the other two [DN], interpolated where a mosaic has others there; none of a mono camera."""


def predict_off(
    on: Array, pixel_format: PixelFormat, line: LaserLine, *, elsewhere: Channels | None = None
) -> UInt8[np.ndarray, "frames ..."]:
    """Laser-off frames for laser-on frames that have none; each from its own frame alone.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        pixel_format: How a frame is to be read.
        line: The laser, of which the colour is known.
        elsewhere: Levels that other frames predict for the only frame, taken where they are good.

    Returns:
        Frames of the same shape: the laser's channel predicted, the others as they are.
    """
    on = np.asarray(on)
    off = on.copy()
    for k in range(len(on)):
        part = slice(k, k + 1)
        room = _room(read_channels(on[part], pixel_format, line), elsewhere, laser_sites(pixel_format, line).pitch)
        plane = np.clip(np.rint(room), 0, 255).astype(np.uint8)
        put_plane(off[part], plane, pixel_format=pixel_format, line=line)
        if pixel_format == "rgb8":
            _clear_others(off[part], on[part], line)
    return off


def _clear_others(off: np.ndarray, on: np.ndarray, line: LaserLine) -> None:
    """The other channels along the line, where the laser's is clipped: they see the laser there."""
    seen = read_channels(on, "rgb8", line)
    clipped = _near(seen.laser >= _CLIPPED, _NEAR_PX)
    if not clipped.any():
        return
    for colour, plane in zip([one for one in _COLOURS if one != line.colour], seen.others, strict=True):
        room = np.where(clipped, _along(plane, _HALF_PX), plane)
        other = dataclasses.replace(line, colour=colour)
        put_plane(off, np.rint(room).astype(np.uint8), pixel_format="rgb8", line=other)


def _room(seen: Channels, elsewhere: Channels | None, pitch: int) -> Planes:
    half, close = _HALF_PX // pitch, _NEAR_PX // pitch
    level = seen.laser.astype(np.float32)
    clipped = _near(seen.laser >= _CLIPPED, half)
    rooms = [np.zeros_like(level)]
    if seen.others:
        rooms.append(_from_others(level, seen.others, _near(seen.laser >= _CLIPPED, close), half))
    if elsewhere is not None:
        moved = elsewhere.laser.astype(np.float32)
        if seen.others:
            changes = (now - then for now, then in zip(seen.others, elsewhere.others, strict=True))
            # Where the light has changed all channels have; where they are clipped they see the laser.
            moved = moved + np.where(clipped, 0.0, sum(changes, np.zeros_like(level)) / len(seen.others))
        rooms.append(moved)
    return _best(level, [room + _rest(level - room, clipped, half, close) for room in rooms], half)


def _rest(difference: Planes, clipped: Bool[np.ndarray, "frames lines samples"], half: int, close: int) -> Planes:
    near = _along(difference + 256.0, close) - np.float32(256.0)
    if not clipped.any():
        return near
    return np.where(clipped, _along(difference + 256.0, half) - np.float32(256.0), near)


def _best(level: Planes, rooms: Sequence[Planes], half: int) -> Planes:
    """Of all predictions the one with the smallest residuals around; the laser only adds light."""
    best, least = rooms[0], None
    for room in rooms:
        size = box_mean(np.minimum(np.abs(level - room), np.float32(_MOST_DN)), half, _AROUND)
        if least is None:
            least = size
        else:
            better = size < least
            best, least = np.where(better, room, best), np.minimum(size, least)
    return best


def _from_others(
    level: Planes, others: tuple[Planes, ...], clipped: Bool[np.ndarray, "frames lines samples"], half: int
) -> Planes:
    mixed = np.stack([_mixture(*planes) for planes in zip(level, *others, strict=True)])
    if clipped.any():
        mixed = np.where(clipped, np.minimum(mixed, _along(mixed, half)), mixed)
    ratio = np.log2((level + np.float32(_SOFT_DN)) / (mixed + np.float32(_SOFT_DN)))
    codes = np.clip(np.rint(_PER_OCTAVE * ratio) + _CODES // 2, 0, _CODES - 1).astype(np.int16)
    hue = np.exp2((running_median(codes, half) - np.float32(_CODES // 2)) / np.float32(_PER_OCTAVE))
    return np.maximum(hue * (mixed + np.float32(_SOFT_DN)) - np.float32(_SOFT_DN), 0.0)


def _mixture(level: np.ndarray, *others: np.ndarray) -> Float[np.ndarray, "lines samples"]:
    """The mixture of the other channels that is most like the laser's, by least absolute residuals."""
    every = max(1, level.size // _LATTICE)
    lattice = np.stack([plane.reshape(-1)[::every] for plane in (*others, np.ones_like(level), level)], 1)
    usable = lattice[:, [*range(len(others)), -1]].max(1) < _CLIPPED
    x, y = lattice[usable, :-1].astype(np.float64), lattice[usable, -1].astype(np.float64)
    share = np.array([1.0 / len(others)] * len(others) + [0.0])
    for _ in range(_STEPS):
        weight = 1.0 / np.maximum(np.abs(y - x @ share), 1.0)
        # Where all surfaces have one hue the mixture is open: of those that fit the smallest.
        share = np.linalg.lstsq((weight[:, None] * x).T @ x, (weight * y) @ x, rcond=1e-9)[0]
    mixed = sum((s * plane for s, plane in zip(share, others, strict=False)), np.full_like(level, share[-1]))
    return np.maximum(np.asarray(mixed, np.float32), 0.0)


def _near(marked: Bool[np.ndarray, "frames lines samples"], half: int) -> Bool[np.ndarray, "frames lines samples"]:
    """Samples within reach of a marked one on their line."""
    before = np.cumsum(np.pad(marked, ((0, 0), (0, 0), (half + 1, half))), 2, dtype=np.int32)
    return before[:, :, 2 * half + 1 :] - before[:, :, : -2 * half - 1] > 0


def box_mean(values: Planes, samples: int, lines: int) -> Planes:
    """Mean over so many samples and lines on either side; over fewer at the borders."""
    for axis, reach in ((2, samples), (1, lines)):
        size = values.shape[axis]
        total = np.zeros([size + 1 if k == axis else length for k, length in enumerate(values.shape)], np.float32)
        np.cumsum(values, axis, out=total[:, 1:] if axis == 1 else total[:, :, 1:])
        first, last = np.maximum(np.arange(size) - reach, 0), np.minimum(np.arange(size) + reach + 1, size)
        number = (last - first).astype(np.float32)
        if axis == 1:
            values = (total[:, last] - total[:, first]) / number[:, None]
        else:
            values = (total[:, :, last] - total[:, :, first]) / number
    return values


def _along(level: Planes, half: int) -> Planes:
    codes = np.clip(np.rint(2.0 * level), 0, _CODES - 1).astype(np.int16)
    return np.float32(0.5) * running_median(codes, half).astype(np.float32)


def running_median(
    codes: Int16[np.ndarray, "frames lines samples"], half: int
) -> Int16[np.ndarray, "frames lines samples"]:
    """Median along each line of the samples within `half` on both sides; near its ends of those and of as many below
    as above all.

    Args:
        codes: Values from 0 to `_CODES` - 1.
        half: Samples on either side.
    """
    ends = np.where(np.arange(half) % 2 == 0, -1, _CODES).astype(np.int16)
    wide = np.pad(codes, ((0, 0), (0, 0), (half, half)))
    wide[:, :, :half], wide[:, :, -half:] = ends[::-1], ends
    # One long line, for which SciPy keeps the window sorted.
    found = scipy.ndimage.median_filter(wide.reshape(-1), size=2 * half + 1).reshape(wide.shape)
    return np.clip(found[:, :, half:-half], 0, _CODES - 1)


def warped(
    planes: Float[np.ndarray, "planes lines samples"], where: Float[np.ndarray, "a b 2"], pitch: int
) -> Float[np.ndarray, "planes lines samples"]:
    """Planes read at other places, bilinear; beyond them their border.

    Args:
        planes: float32.
        where: Line and sample that are read, at every `pitch`-th line and sample; bilinear in between.
        pitch: Distance of the given places.
    """
    lines, samples = planes.shape[1:]
    i, j = (np.arange(size) // pitch for size in (lines, samples))
    down, right = ((np.arange(size) % pitch).astype(np.float32) / np.float32(pitch) for size in (lines, samples))
    along = where[i] + down[:, None, None] * (where[i + 1] - where[i])
    places = along[:, j] + right[None, :, None] * (along[:, j + 1] - along[:, j])
    at = np.moveaxis(places, -1, 0)
    read = lambda plane: scipy.ndimage.map_coordinates(plane, at, np.float32, order=1, mode="nearest")
    return np.stack([read(plane) for plane in planes])


def read_channels(on: UInt8[np.ndarray, "frames ..."], pixel_format: PixelFormat, line: LaserLine) -> Channels:
    """All channels of frames uint8 [frames, rows, columns] (rgb8: and 3) where the laser's is measured."""
    laser = np.ascontiguousarray(laser_plane(on, pixel_format=pixel_format, line=line))
    names = [colour for colour in _COLOURS if colour != line.colour]
    if pixel_format == "mono8":
        return Channels(laser, ())
    if pixel_format == "rgb8":
        planes = [on[..., _COLOURS.index(name)] for name in names]
        if line.stripe_axis == "columns":
            planes = [plane.swapaxes(1, 2) for plane in planes]
        return Channels(laser, tuple(plane.astype(np.float32) for plane in planes))
    full = [_interpolated(on, pixel_format, name) for name in names]
    others = (laser_plane(plane, pixel_format=pixel_format, line=line) for plane in full)
    return Channels(laser, tuple(np.ascontiguousarray(other) for other in others))


def put_plane(
    frames: UInt8[np.ndarray, "frames ..."],
    plane: UInt8[np.ndarray, "frames lines samples"],
    *,
    pixel_format: PixelFormat,
    line: LaserLine,
) -> None:
    """Write the samples of the laser's channel into frames; the inverse of `laser_plane`."""
    if pixel_format == "rgb8":
        frames = frames[..., _COLOURS.index(str(line.colour))]
    if line.stripe_axis == "columns":
        frames = frames.swapaxes(1, 2)
    sites = laser_sites(pixel_format, line)
    kinds, (_, lines, samples) = len(sites.offsets), plane.shape
    for k, offset in enumerate(sites.offsets):
        rows = slice(sites.first_line + sites.line_step * k, sites.first_line + sites.line_step * lines, None)
        target = frames[:, rows][:, :: sites.line_step * kinds, offset :: sites.pitch]
        target[:, :, :samples] = plane[:, k::kinds]


def _interpolated(on: np.ndarray, pixel_format: PixelFormat, colour: str) -> Float[np.ndarray, "frames rows columns"]:
    """One colour of a mosaic at every pixel, bilinear."""
    tile = pixel_format[6:10]
    here = np.zeros(on.shape[1:], np.float32)
    for k, letter in enumerate(tile):
        here[k // 2 :: 2, k % 2 :: 2] = letter == colour[0]
    return _spread(on * here) / _spread(here[None])


def _spread(values: Float[np.ndarray, "frames rows columns"]) -> Float[np.ndarray, "frames rows columns"]:
    for axis in (1, 2):
        padded = np.pad(values, [(1, 1) if k == axis else (0, 0) for k in range(3)])
        before, here, after = (np.take(padded, range(k, k + values.shape[axis]), axis) for k in range(3))
        values = before + 2.0 * here + after
    return values
