"""Compares pairs: two of the same place, the leak of the laser over several, the light of the room over many."""

from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np
from jaxtyping import UInt8

from jaxscan.stripes import LaserLine, PixelFormat, Response, decode_table, laser_plane, laser_sites
from scanrig.checks.measures import find_ridges


PLACES = 8
"""Places over which a leak is judged: striped wallpaper along the laser's line looks like a leak at every third."""
APART_DEG = 2.0
"""Least turn after which the laser's line counts as falling on another place."""


class LeakWatch:
    """Follows the leak of the laser's line into the laser-off frames, from place to place.

    Texture along the line looks like a leak of a tenth to a third, of either sign, but only at single places. A laser
    that goes out slowly leaks at every place.
    """

    def __init__(self) -> None:
        self._leaks: deque[float] = deque(maxlen=PLACES)
        self._last_deg: float | None = None

    def add(self, angle_deg: float | None, leak: float) -> float | None:
        """Add a pair: the table's angle, None if every pair shows another scene, as with boards; and its leak.

        Returns:
            The median over the last `PLACES` places; None while there are fewer, and if the table has hardly moved
            since the last.
        """
        if angle_deg is not None:
            if self._last_deg is not None and abs(angle_deg - self._last_deg) < APART_DEG - 1e-9:
                return None
            self._last_deg = angle_deg
        self._leaks.append(leak)
        return median(self._leaks) if len(self._leaks) == PLACES else None


_FACTOR = 2.0
_BLACK_DN = 2.0
"""Level that is added before the comparison: in the dark a count more or less is no change."""


class LightWatch:
    """Follows the mean level of the laser-off frames."""

    def __init__(self) -> None:
        self._level_dn: float | None = None

    def add(self, level_dn: float) -> float | None:
        """Add a pair; the level before [DN] if the light has changed by a factor of two since, else None."""
        was = self._level_dn
        if was is not None and 1 / _FACTOR < (level_dn + _BLACK_DN) / (was + _BLACK_DN) < _FACTOR:
            return None
        self._level_dn = level_dn
        return was


_WINDOW = 8
"""Samples on either side of a ridge over which its centre is computed."""
_FEWEST = 5
"""Fewest lines with the laser in both pairs for which a shift is computed."""
_BLOCK_PX = 8
"""Side of the blocks whose means are compared; the means have little noise."""
_AROUND = 5
"""Side of the neighbourhood, in blocks, whose mean is subtracted: wider structure may come from the lamps."""
_CONTRAST = 4.0
"""Least ratio of the variance of such means to that of noise for which they are compared."""
_ROUNDING = 1.0 / 12.0
"""Variance of rounding [DN²], the least noise of a frame."""


@dataclass(frozen=True)
class Likeness:
    """The difference of two pairs."""

    shift_px: float | None
    """Shift of the stripe: median over the lines on which both pairs show it [px]; None if these are too few."""
    lines: int
    correlation: float | None
    """Correlation of the laser-off frames' structure, 1 for the same view in any light [1]; None if they show too
    little structure above noise."""

    def __str__(self) -> str:
        shift = (
            "the line is not on the same rows" if self.shift_px is None else f"the line moved {self.shift_px:+.2f} px"
        )
        frames = (
            "have too little contrast to compare by" if self.correlation is None else f"agree by {self.correlation:.2f}"
        )
        return f"{shift}, the laser-off frames {frames}"

    def fields(self) -> dict[str, float]:
        """What is known of it, as the journal keeps it."""
        shift = {} if self.shift_px is None else {"shift_px": round(self.shift_px, 3)}
        seen = {} if self.correlation is None else {"correlation": round(self.correlation, 4)}
        return shift | seen

    def within(self, shift_px: float, correlation: float) -> bool:
        """Whether it is the same view: the shift must be known; an unknown correlation is ignored."""
        seen = self.correlation is None or self.correlation >= correlation
        return seen and self.shift_px is not None and abs(self.shift_px) <= shift_px


def compare_pairs(
    first: tuple[UInt8[np.ndarray, "rows columns *three"], UInt8[np.ndarray, "rows columns *three"]],
    again: tuple[UInt8[np.ndarray, "rows columns *three"], UInt8[np.ndarray, "rows columns *three"]],
    *,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
) -> Likeness:
    """Compare two pairs (laser-on frame, laser-off frame) of the same view.

    For the colour "auto" the green channel is used.
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
    return Likeness(shift, lines, _correlation(planes[1], planes[3], laser_sites(pixel_format, line).pitch))


def _correlation(first: np.ndarray, again: np.ndarray, pitch: int) -> float | None:
    """Correlation of two views of the room, independent of lamps and daylight; None if they show no structure.

    Corrected for noise, so that dim and bright rooms are judged alike.
    """
    means, noises = zip(*(_structure(plane, _BLOCK_PX // pitch) for plane in (first, again)), strict=True)
    variances = [float(np.mean(mean**2)) for mean in means]
    if any(variance < _CONTRAST * noise for variance, noise in zip(variances, noises, strict=True)):
        return None
    real = np.prod([variance - noise for variance, noise in zip(variances, noises, strict=True)])
    return float(np.mean(means[0] * means[1]) / np.sqrt(real))


def _structure(plane: np.ndarray, side: int) -> tuple[np.ndarray, float]:
    """Means of blocks minus the mean of their neighbourhood [DN], and the variance of their noise [DN²]."""
    rows, columns = (size // side for size in plane.shape)
    blocks = plane[: rows * side, : columns * side].reshape(rows, side, columns, side).astype(np.float64)
    mean = blocks.mean((1, 3))
    # Black against white fields of a chessboard: structure cancels, noise remains.
    sign = np.where(np.add.outer(np.arange(side), np.arange(side)) % 2, -1.0, 1.0)
    noise = np.mean((blocks * sign[None, :, None, :]).mean((1, 3)) ** 2)
    around = np.pad(mean, _AROUND // 2, mode="reflect")
    wide = np.lib.stride_tricks.sliding_window_view(around, (_AROUND, _AROUND)).mean((2, 3))
    return mean - wide, max(float(noise), _ROUNDING / side**2)


def _centres(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the laser's light on each line of its plane [samples], and whether there is one."""
    difference = np.ascontiguousarray(on - off)
    ridges = find_ridges(difference, np.ascontiguousarray(off)).ridges
    x = np.clip(ridges.at[:, None] + np.arange(-_WINDOW, _WINDOW + 1), 0, difference.shape[1] - 1)
    light = np.take_along_axis(difference, x, 1)
    # Only above half of the height: noise in the tails would pull the centre towards the middle of the window.
    light = np.maximum(light - 0.5 * light.max(1, keepdims=True), 0.0)
    total = light.sum(1)
    return (light * x).sum(1) / np.where(total > 0, total, 1.0), ridges.clear & (total > 0)
