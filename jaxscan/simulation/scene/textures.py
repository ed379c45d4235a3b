"""Procedural patterns over (u, v) in metres, and materials made of them.

A pattern gives two colours, their mixture and a brightness for each point. So one evaluation serves
a colour camera, a mono camera and the laser's single wavelength.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np


Rgb = tuple[float, float, float]


class Blend(NamedTuple):
    """Colour = (palette[first] + mix (palette[second] - palette[first])) * shade."""

    first: np.ndarray | int
    second: np.ndarray | int
    mix: np.ndarray | float
    shade: np.ndarray | float


Pattern = Callable[[np.ndarray, np.ndarray], Blend]


def plain(u: np.ndarray, v: np.ndarray) -> Blend:
    """One colour."""
    return Blend(0, 0, 0.0, 1.0)


def plaster(u: np.ndarray, v: np.ndarray) -> Blend:
    """One colour, a little uneven."""
    shade = np.sin(7.1 * u + 3 * np.sin(3.3 * v))
    return Blend(0, 0, 0.0, 1 + np.float32(0.02) * shade)


def stripes(u: np.ndarray, v: np.ndarray, *, period: float) -> Blend:
    """Upright bars of the second colour."""
    return Blend(0, 1, (_fraction(u / np.float32(period)) < 0.5).astype(np.float32), 1.0)


def bands(u: np.ndarray, v: np.ndarray, *, period: float) -> Blend:
    """Level bars of the second colour."""
    return stripes(v, u, period=period)


def dots(u: np.ndarray, v: np.ndarray, *, period: float, radius: float) -> Blend:
    """Dots of the second colour, every other row shifted by half."""
    row = np.floor(v / np.float32(period))
    x = _fraction(u / np.float32(period) + np.float32(0.5) * (row % 2)) - np.float32(0.5)
    y = v / np.float32(period) - row - np.float32(0.5)
    return Blend(0, 1, (x * x + y * y < np.float32((radius / period) ** 2)).astype(np.float32), 1.0)


def checker(u: np.ndarray, v: np.ndarray, *, size: float) -> Blend:
    """Squares of two colours."""
    odd = (np.floor(u / np.float32(size)) + np.floor(v / np.float32(size))) % 2
    return Blend(0, 1, odd.astype(np.float32), 1.0)


def rings(u: np.ndarray, v: np.ndarray, *, period: float, centre: tuple[float, float]) -> Blend:
    """Concentric rings of two colours."""
    r = np.hypot(u - np.float32(centre[0]), v - np.float32(centre[1]))
    return Blend(0, 1, (_fraction(r / np.float32(period)) < 0.5).astype(np.float32), 1.0)


def planks(u: np.ndarray, v: np.ndarray, *, width: float, length: float) -> Blend:
    """Floor boards: each of its own tone, with grain and dark joints."""
    row = np.floor(v / np.float32(width))
    along = u / np.float32(length) + np.float32(0.37) * row
    column = np.floor(along)
    tone = _hash(row, column)
    grain = np.sin(55 * v + 9 * tone + np.float32(1.5) * np.sin(2.3 * u + 20 * tone))
    edge_v = np.abs(v / np.float32(width) - row - np.float32(0.5)) > np.float32(0.5 - 0.002 / width)
    edge_u = np.abs(along - column - np.float32(0.5)) > np.float32(0.5 - 0.002 / length)
    shade = np.where(edge_v | edge_u, np.float32(0.45), 1 + np.float32(0.05) * grain)
    return Blend(0, 1, tone, shade)


def tiles(u: np.ndarray, v: np.ndarray, *, size: float) -> Blend:
    """Tiles with joints of the second colour."""
    x, y = _fraction(u / np.float32(size)), _fraction(v / np.float32(size))
    gap = np.float32(0.004 / size)
    joint = (x < gap) | (y < gap)
    tone = _hash(np.floor(u / np.float32(size)), np.floor(v / np.float32(size)))
    return Blend(0, 1, joint.astype(np.float32), np.float32(0.94) + np.float32(0.12) * tone)


def wood(u: np.ndarray, v: np.ndarray) -> Blend:
    """Grain along u."""
    wave = np.sin(90 * v + 3 * np.sin(2.1 * u) + 2 * np.sin(17 * v))
    return Blend(0, 1, np.float32(0.5) + np.float32(0.5) * wave, 1.0)


def weave(u: np.ndarray, v: np.ndarray, *, period: float = 0.03) -> Blend:
    """Coarse cloth."""
    wave = np.sin(u * np.float32(2 * np.pi / period)) * np.sin(v * np.float32(2 * np.pi / period))
    return Blend(0, 1, np.float32(0.5) + np.float32(0.5) * wave, 1.0)


def books(u: np.ndarray, v: np.ndarray, *, width: float, height: float, colours: int) -> Blend:
    """Spines side by side, each of its own colour (of the palette) and height."""
    place = np.floor(u / np.float32(width))
    tone = _hash(place, np.floor(v / np.float32(height)))
    index = 1 + np.floor(tone * np.float32(0.999 * (colours - 1))).astype(np.intp)
    x = u / np.float32(width) - place
    y = _fraction(v / np.float32(height))
    tall = np.float32(0.6) + np.float32(0.32) * _hash(place, tone * 99)
    band = np.where(np.abs(y - np.float32(0.45)) < 0.03, np.float32(1.5), np.float32(1.0))
    return Blend(np.where(y < tall, index, 0), 0, 0.0, np.where(x < 0.08, np.float32(0.4), band))


def border(u: np.ndarray, v: np.ndarray, *, size: tuple[float, float], width: float, inner: Pattern) -> Blend:
    """A frame of the last colour round another pattern; the surface is `size` [m] large."""
    blend = inner(u, v)
    frame = (u < width) | (v < width) | (u > size[0] - width) | (v > size[1] - width)
    return Blend(
        np.where(frame, -1, blend.first), np.where(frame, -1, blend.second), np.where(frame, 0, blend.mix), blend.shade
    )


def panes(u: np.ndarray, v: np.ndarray, *, size: tuple[float, float], bar: float) -> Blend:
    """A window: sky behind a frame (second colour) with one cross."""
    frame = (u < bar) | (v < bar) | (u > size[0] - bar) | (v > size[1] - bar)
    cross = (np.abs(u - size[0] / 2) < bar / 2) | (np.abs(v - size[1] * 0.6) < bar / 2)
    mix = (frame | cross).astype(np.float32)
    return Blend(0, 1, mix, np.float32(0.9) + np.float32(0.1 / size[1]) * v)


@dataclass(frozen=True)
class Material:
    """A pattern and the colours (albedos) it is made of."""

    palette: tuple[Rgb, ...]
    pattern: Pattern = plain
    glow: float = 0.0
    """Light of its own, in units of a white surface in mean light."""
    mirror: float = 0.0
    """Share of the light that it reflects as a mirror."""

    def albedo(self, u: np.ndarray, v: np.ndarray, channels: np.ndarray) -> np.ndarray:
        """Albedo [channels, points] at (u, v) [m]; `channels` [3, channels] weighs R, G and B."""
        palette = np.asarray(self.palette, np.float32) @ channels.astype(np.float32)
        first, second, mix, shade = self.pattern(u, v)
        planes = np.empty((palette.shape[1], len(u)), np.float32)
        for plane, colours in zip(planes, palette.T, strict=True):
            low = colours[first]
            plane[:] = (low + (colours[second] - low) * mix) * shade
        return planes


def framed(size: tuple[float, float], palette: tuple[Rgb, ...], inner: Pattern, width: float = 0.04) -> Material:
    """A picture: a pattern in a frame, whose colour is the palette's last."""
    return Material(palette, partial(border, size=size, width=width, inner=inner))


def _fraction(x: np.ndarray) -> np.ndarray:
    return x - np.floor(x)


def _hash(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A number in [0, 1) for each pair of whole numbers (or any others): the same every time."""
    x = np.sin(a * np.float32(12.9898) + b * np.float32(78.233)) * np.float32(4375.85)
    return _fraction(x).astype(np.float32)
