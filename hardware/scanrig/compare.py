"""Whether a pair that was taken again shows what it showed the first time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from jaxscan.stripes.frames import LaserLine, PixelFormat, Response, decode_table, laser_plane, laser_sites
from scanrig.ridges import find_ridges


_WINDOW = 8
"""Samples on either side of a ridge over which its centre of light is formed."""
_FEWEST = 5
"""Lines that both pairs must show the laser on before a shift means anything."""


@dataclass(frozen=True)
class Likeness:
    """How two pairs differ."""

    shift_px: float | None
    """How far the line has moved: median over the lines on which both show it [px]; None where there are too few."""
    lines: int
    """Lines on which both show it."""
    difference_dn: float
    """Mean absolute difference of the laser-off frames, that of their brightness taken out [DN]."""

    def __str__(self) -> str:
        shift = (
            "the line is not on the same rows" if self.shift_px is None else f"the line moved {self.shift_px:+.2f} px"
        )
        return f"{shift}, the laser-off frames differ by {self.difference_dn:.1f} DN"

    def within(self, shift_px: float, difference_dn: float) -> bool:
        """Whether it is the same view; an unknown shift is none."""
        return self.difference_dn <= difference_dn and self.shift_px is not None and abs(self.shift_px) <= shift_px


def compare_pairs(
    first: tuple[UInt8[np.ndarray, "rows columns *three"], UInt8[np.ndarray, "rows columns *three"]],
    again: tuple[UInt8[np.ndarray, "rows columns *three"], UInt8[np.ndarray, "rows columns *three"]],
    *,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
) -> Likeness:
    """Compare two pairs (laser-on frame, laser-off frame) of the same view.

    Args:
        first: As it was, uint8 [rows, columns] (rgb8: and 3) each.
        again: As it is, of the same shape.
        pixel_format: How a frame is to be read.
        response: "linear" or "srgb".
        line: The laser; of a colour "auto" the green channel is taken.
    """
    if line.colour == "auto":
        line = LaserLine(line.name, "green", line.stripe_axis)
    level = decode_table(response)[0].astype(np.float32)
    frames = np.stack([*first, *again])
    planes = level[np.asarray(laser_plane(frames, pixel_format=pixel_format, line=line))]
    (at_first, seen_first), (at_again, seen_again) = (_centres(planes[k], planes[k + 1]) for k in (0, 2))
    both = seen_first & seen_again
    lines = int(np.count_nonzero(both))
    shift = None
    if lines >= _FEWEST:
        shift = float(np.median((at_again - at_first)[both])) * laser_sites(pixel_format, line).pitch
    # Lamps and daylight come and go; what they shine on stays where it is.
    gain = float(planes[3].sum()) / max(float(planes[1].sum()), 1.0)
    return Likeness(shift, lines, float(np.abs(planes[3] - np.float32(gain) * planes[1]).mean()))


def _centres(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the laser's light on each line of its plane [samples], and where there is one."""
    difference = np.ascontiguousarray(on - off)
    ridges = find_ridges(difference, np.ascontiguousarray(off)).ridges
    x = np.clip(ridges.at[:, None] + np.arange(-_WINDOW, _WINDOW + 1), 0, difference.shape[1] - 1)
    light = np.take_along_axis(difference, x, 1)
    # Half of the height: the tails, where noise is all there is, would pull towards the window's middle.
    light = np.maximum(light - 0.5 * light.max(1, keepdims=True), 0.0)
    total = light.sum(1)
    return (light * x).sum(1) / np.where(total > 0, total, 1.0), ridges.clear & (total > 0)
