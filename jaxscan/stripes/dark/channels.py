"""The laser's channel and the others, on the same pixels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.stripes.frames import Colour, LaserLine, PixelFormat, laser_plane, laser_sites


COLOURS: tuple[Colour, ...] = ("red", "green", "blue")


class Channels(NamedTuple):
    """Planes of a chunk of frames on the pixels of the laser's channel."""

    laser: UInt8[np.ndarray, "frames lines samples"]
    """Level of the laser's channel [DN]."""
    others: tuple[Float[np.ndarray, "frames lines samples"], ...]
    """Levels of the other two [DN], interpolated where a mosaic has others there; none of a mono camera."""


def read_channels(on: UInt8[np.ndarray, "frames ..."], pixel_format: PixelFormat, line: LaserLine) -> Channels:
    """All channels of frames uint8 [frames, rows, columns] (rgb8: and 3) where the laser's is measured."""
    laser = np.ascontiguousarray(laser_plane(on, pixel_format=pixel_format, line=line))
    names = [colour for colour in COLOURS if colour != line.colour]
    if pixel_format == "mono8":
        return Channels(laser, ())
    if pixel_format == "rgb8":
        planes = [on[..., COLOURS.index(name)] for name in names]
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
        frames = frames[..., COLOURS.index(str(line.colour))]
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
