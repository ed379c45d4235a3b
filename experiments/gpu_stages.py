"""The stages that run on an accelerator, for `gpu_speed.py`: frames to stripes, a path over the rows, points."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
from jaxtyping import Float, Int, UInt8

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import ReconstructSettings
from jaxscan.reconstruction.points import Centres, Points, Rig, locate_points
from jaxscan.stripes import StripeSettings
from jaxscan.stripes.extract import FrameStripes, stripes_of_frames
from jaxscan.stripes.frames import LaserLine


class Chunk(NamedTuple):
    """Pairs of frames on a device."""

    on: UInt8[jax.Array, "pairs rows columns"]
    off: UInt8[jax.Array, "pairs rows columns"]
    laser: Int[jax.Array, " pairs"]
    phi: Float[jax.Array, " pairs"]


class Stage(NamedTuple):
    """A part of the way from frames to points."""

    name: str
    run: Callable[..., Any]
    """`run(rig, chunk, given, noise)`: `given` is what the stage before returned."""
    is_path: bool = False
    """Whether it is the path over the rows, which is reported apart."""


def prepare(scanner: Scanner, device: jax.Device) -> Rig:
    """What every chunk needs of the scanner, on the device."""
    return jax.device_put(Rig.of(scanner, "rows"), device)


def to_stripes(rig: Rig, chunk: Chunk, given: Any, noise: tuple) -> FrameStripes:
    """Locate and fit."""
    del rig, given
    options = {"pixel_format": "mono8", "response": "linear", "line": LaserLine(), "settings": StripeSettings()}
    return stripes_of_frames(chunk.on, chunk.off, *noise, **options)


def to_points(rig: Rig, chunk: Chunk, given: FrameStripes, noise: tuple) -> Points:
    """Triangulate and colour."""
    del noise
    centres = Centres(given.u, given.sigma, given.amplitude, given.valid)
    options = {"pixel_format": "mono8", "stripe_axis": "rows", "settings": ReconstructSettings()}
    return locate_points(rig, centres, chunk.off, chunk.laser, chunk.phi, **options)


STAGES = (Stage("locate and fit", to_stripes), Stage("triangulate and colour", to_points))


def all_of_it(rig: Rig, chunk: Chunk, noise: tuple) -> tuple[Any, ...]:
    """All stages at once, and what is compared: the stripes and the points."""
    stripes = to_stripes(rig, chunk, None, noise)
    return stripes, to_points(rig, chunk, stripes, noise)
