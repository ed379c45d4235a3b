"""The channels of a colour camera as a bracket: where the laser's is clipped, another one sees the stripe well."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Colour, LaserLine
from jaxscan.stripes.search import ExtractionSetup, LineGate
from jaxscan.stripes.stripes import FrameStripes


_COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
_NOTICEABLE = 0.05
"""Part of the lines with a stripe on which it is clipped, from which other channels are looked at [1]."""
_LIGHT_DN = 20.0
"""Light of the laser that says how much of it the other channels see [DN]."""
_LEAST = 0.005
"""Smallest part of the laser's light that is worth a search [1]."""
_FEW = 50
_ELSEWHERE_PX = 1.0
"""Distance of two channels' centres beyond the stripe's width, from which one shows something else [px]."""


class OtherChannel(NamedTuple):
    """Another channel that sees the laser."""

    line: LaserLine
    response: float
    """Its light over that of the laser's own channel [1]."""


def other_channels(on: Array, off: Array | None, setup: ExtractionSetup, gate: LineGate) -> list[OtherChannel]:
    """The other channels, where the laser's own is clipped on many lines of the first frames.

    Args:
        on: Laser-on frames of the first records, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape; without them there are no other channels.
        setup: Frames and laser, of which the colour is known.
        gate: The part of every line that may hold the stripe.
    """
    if off is None or setup.frames.pixel_format == "mono8":
        return []
    # In a mosaic the samples of one tile are compared.
    lit, room = (_tiles(np.asarray(frames), setup) for frames in (on, off))
    own, top = _COLOURS.index(str(setup.line.colour)), setup.settings.saturation
    scale = max(setup.image_lines // lit.shape[1], 1)
    low, high = (np.asarray(side)[: lit.shape[1] * scale : scale] // scale for side in (gate.low, gate.high))
    sample = np.arange(lit.shape[2])
    inside = (sample >= low[:, None]) & (sample < high[:, None])
    light = lit[..., own].astype(np.int16) - room[..., own]
    seen = inside & (light > _LIGHT_DN)
    clipped = seen & (lit[..., own] >= top) & (room[..., own] < top)
    if np.count_nonzero(clipped.any(2)) < max(_NOTICEABLE * np.count_nonzero(seen.any(2)), 1):
        return []
    found = []
    for k, colour in enumerate(_COLOURS):
        usable = seen & ~clipped & (lit[..., k] < top)
        if k == own or np.count_nonzero(usable) < _FEW:
            continue
        other = (lit[..., k].astype(np.int16) - room[..., k])[usable]
        response = float(np.sum(other) / np.sum(light[usable], dtype=np.float64))
        if response > _LEAST:
            found.append(OtherChannel(dataclasses.replace(setup.line, colour=colour), response))
    return found


def _tiles(frames: np.ndarray, setup: ExtractionSetup) -> np.ndarray:
    """All three channels, uint8 [frames, lines, samples, 3]; of a mosaic one sample of each colour in a tile."""
    if setup.frames.pixel_format != "rgb8":
        tile = setup.frames.pixel_format[6:10]
        rows, columns = (size // 2 * 2 for size in frames.shape[1:3])
        corner = [frames[:, tile.index(c) // 2 : rows : 2, tile.index(c) % 2 : columns : 2] for c in "rgb"]
        frames = np.stack(corner, -1)
    return frames.swapaxes(1, 2) if setup.line.stripe_axis == "columns" else frames


def doubts_of(found: Sequence[FrameStripes], step: int) -> tuple[float, ...]:
    """Variances that the centres of channels have beyond their own [px^2].

    All channels see the same surface, so that of their scatter from line to line the differences alone are errors.

    Args:
        found: Stripes of the same frames [frames, lines] in each channel.
        step: Distance of lines that all channels have.
    """
    before, here, after = np.s_[:, : -2 * step], np.s_[:, step:-step], np.s_[:, 2 * step :]
    valid = np.logical_and.reduce([np.asarray(one.valid) for one in found])
    known = valid[before] & valid[here] & valid[after]
    if np.count_nonzero(known) < _FEW:
        return (0.0,) * len(found)
    bends = [(u[here] - 0.5 * (u[before] + u[after]))[known] for u in (np.asarray(one.u) for one in found)]
    scatter = [_variance(bend) for bend in bends]
    stated = [float(np.median(np.asarray(one.sigma)[here][known])) ** 2 for one in found]
    best = int(np.argmin(scatter))

    def doubt(k: int) -> float:
        # No more than the difference of the two channels, in which the surface's own relief cancels.
        rougher = scatter[k] - scatter[best] - max(stated[k] - stated[best], 0.0)
        unlike = _variance(bends[k] - bends[best]) - stated[k] - stated[best]
        return max(min(rougher, unlike), 0.0)

    return tuple(doubt(k) for k in range(len(found)))


def doubted(stripes: FrameStripes, own: FrameStripes, doubt: float) -> FrameStripes:
    """Stripes of a channel with an error more, without those that lie elsewhere than the laser's own channel has them.

    Args:
        stripes: Of the channel.
        own: Of the laser's own channel.
        doubt: Variance of the centres beyond their own [px^2].
    """
    near = np.abs(stripes.u - own.u) < own.width + _ELSEWHERE_PX
    sigma = np.sqrt(stripes.sigma**2 + np.where(stripes.valid, np.float32(doubt), np.float32(0)))
    return stripes._replace(sigma=sigma, valid=stripes.valid & (~own.valid | near))


def _variance(bend: np.ndarray) -> float:
    """Variance of a centre from those of a centre minus the mean of two others; edges do not matter."""
    return float(np.quantile(np.abs(bend), 0.683)) ** 2 / 1.5
