"""Frames without a renderer: a Gaussian laser line on a textured wall, with noise."""

from typing import Annotated, NamedTuple

import numpy as np
import pydantic
from jaxtyping import Float, UInt8

from jaxscan.files.disk import FileModel, Integer, Number
from jaxscan.geometry import StripeAxis
from jaxscan.stripes import Colour, PixelFormat, frame_rank


_CHANNEL = {"red": 0, "green": 1, "blue": 2}


class SyntheticScene(FileModel):
    """The scene of the simulated camera."""

    colour: Colour = "red"
    """Colour of the laser."""
    stripe_axis: StripeAxis = "rows"
    """One centre per row, or per column."""
    peak_dn: Annotated[Number, pydantic.Field(ge=0)] = 120.0
    """Peak of the line above the wall [DN]."""
    width_px: Annotated[Number, pydantic.Field(gt=0, le=100)] = 1.8
    """Standard deviation of the line [px]."""
    share: Annotated[Number, pydantic.Field(ge=0, le=1)] = 1.0
    """Part of the frame's lines that the laser meets."""
    ambient_dn: Annotated[Number, pydantic.Field(ge=0, le=255)] = 30.0
    """Mean level of the wall [DN]."""
    contrast: Annotated[Number, pydantic.Field(ge=0, le=1)] = 0.4
    """Amplitude of the wall's texture over its mean [1]."""
    turn_px: Annotated[Number, pydantic.Field(ge=0)] = 6000.0
    """How far the wall moves through the frame in one turn [px]."""
    apart_px: Number = 40.0
    """Distance of the second laser's line from the first's [px]."""
    read_dn: Annotated[Number, pydantic.Field(ge=0)] = 1.0
    """Read noise [DN]."""
    electrons_per_dn: Annotated[Number, pydantic.Field(gt=0)] = 40.0
    """Conversion gain [e-/DN]."""
    microsteps_per_turn: Annotated[Integer, pydantic.Field(ge=1)] = 28800
    """Microsteps per turn of the table."""
    seed: Annotated[Integer, pydantic.Field(ge=0)] = 0
    """Seed of the noise."""


class FrameShape(NamedTuple):
    """Size and pixel format of a frame."""

    width: int
    """[px]"""
    height: int
    """[px]"""
    pixel_format: PixelFormat = "mono8"


def stripe_centre(scene: SyntheticScene, position: float, lines: int, samples: int) -> Float[np.ndarray, " lines"]:
    """Centre of the first laser on each line of the frame [px]: a bowed wall in the middle of the frame."""
    k = np.linspace(-1.0, 1.0, lines)
    phase = 2.0 * np.pi * position / scene.microsteps_per_turn
    return samples * (0.5 + 0.06 * np.sin(3.0 * phase) + 0.05 * k + 0.03 * k**2 * np.cos(5.0 * phase))


def wall(scene: SyntheticScene, position: float, lines: int, samples: int) -> Float[np.ndarray, "lines samples"]:
    """Light of the room [DN]: blocks and waves that move as the table turns."""
    x = np.arange(samples, dtype=np.float32)[None, :] + np.float32(scene.turn_px * position / scene.microsteps_per_turn)
    y = np.arange(lines, dtype=np.float32)[:, None]
    waves = np.sin(x / 23.0) * np.cos(y / 31.0) + 0.5 * np.sin((x + 2.0 * y) / 7.0)
    blocks = 1.0 - 2.0 * ((np.floor(x / 64.0) + np.floor(y / 64.0)) % 2)
    return np.maximum(scene.ambient_dn * (1.0 + scene.contrast * (0.4 * waves + 0.4 * blocks)), 0.0)


def line_light(
    scene: SyntheticScene, position: float, lines: int, samples: int, laser: int = 1
) -> Float[np.ndarray, "lines samples"]:
    """Light of a laser (from 1) [DN] on the first `share` of the lines."""
    centre = (stripe_centre(scene, position, lines, samples) + (laser - 1) * scene.apart_px).astype(np.float32)
    offset = np.arange(samples, dtype=np.float32)[None, :] - centre[:, None]
    met = np.arange(lines)[:, None] < scene.share * lines
    return np.float32(scene.peak_dn) * np.exp(np.float32(-0.5) * (offset / np.float32(scene.width_px)) ** 2) * met


def draw(
    scene: SyntheticScene,
    position: float,
    lit: int,
    shape: FrameShape,
    generator: np.random.Generator,
) -> UInt8[np.ndarray, "rows columns *three"]:
    """One frame.

    Args:
        scene: The scene.
        position: Position of the table [microsteps].
        lit: Which laser is on, from 1; 0: none.
        shape: Shape of the frame.
        generator: Generator of the noise; its state advances.
    """
    width, height, pixel_format = shape
    across = scene.stripe_axis == "columns"
    lines, samples = (width, height) if across else (height, width)
    room = wall(scene, position, lines, samples)
    laser = line_light(scene, position, lines, samples, lit) if lit else np.zeros_like(room)
    if across:
        room, laser = room.T, laser.T
    if pixel_format == "mono8":
        light = room + laser
    else:
        light = room[..., None] + laser[..., None] * (np.arange(3) == _CHANNEL[scene.colour])
        light = light if frame_rank(pixel_format) == 3 else _mosaic(light, pixel_format)
    # With more than a few electrons the noise is nearly Gaussian, which is drawn ten times as fast.
    variance = light * np.float32(1.0 / scene.electrons_per_dn) + np.float32(scene.read_dn**2)
    noisy = light + np.sqrt(variance) * generator.standard_normal(light.shape, np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _mosaic(light: Float[np.ndarray, "rows columns 3"], pixel_format: str) -> Float[np.ndarray, "rows columns"]:
    tile = pixel_format[6:10]
    seen = np.empty(light.shape[:2], light.dtype)
    for place, letter in enumerate(tile):
        row, column = divmod(place, 2)
        seen[row::2, column::2] = light[row::2, column::2, "rgb".index(letter)]
    return seen
