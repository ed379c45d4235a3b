"""The planes of the laser's colour of a chunk of frames, and the ratios of the lamps between them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames import applied_ratio, lamp_ratio
from jaxscan.stripes.search.search import Search
from jaxscan.stripes.setup import ExtractionSetup


_LOOKS = (32, 80)
"""Lines and samples of a frame from which the brightness of a pair is compared."""
_FRAMES = 32
"""Frames of which the brightness is compared at once."""


class Planes(NamedTuple):
    """The samples of the laser's colour, as `laser_plane` places them."""

    on: UInt8[Array, "frames lines samples"]
    """Samples with the laser on [DN]."""
    off: UInt8[Array, "frames lines samples"] | None
    """Samples with the laser off [DN], where there are any."""
    lamp_ratio: Float[Array, " frames"]
    """Factor by which the light of each laser-off frame is multiplied before it is subtracted [1]."""


def read_planes(on: Array, off: Array | None, search: Search, setup: ExtractionSetup) -> Planes:
    """The planes of frames uint8 [frames, rows, columns] (rgb8: and 3); pure and traceable."""
    on, off = setup.plane(on), None if off is None else setup.plane(off)
    return Planes(on, off, _ratios(sample_pair(on, off), search, len(on)))


def host_planes(on: Array, off: Array, search: Search, setup: ExtractionSetup) -> Planes:
    """The same as NumPy arrays, for a native search."""

    def plane(frames: Array) -> np.ndarray:
        found = setup.plane(np.asarray(frames))
        # Samples that lie a line apart would each cost a cache line of their own.
        return np.ascontiguousarray(found) if setup.line.stripe_axis == "columns" else np.asarray(found)

    on, off = plane(on), plane(off)
    # Chunks of all lengths share one compiled function.
    room = -(-len(on) // _FRAMES) * _FRAMES
    pair = tuple(np.pad(looks, ((0, room - len(on)), (0, 0))) for looks in _samples(on, off))
    return Planes(on, off, np.asarray(_compiled_ratios(pair, search, room))[: len(on)])


def sample_pair(on: Array, off: Array | None) -> tuple[Array, Array] | None:
    """A lattice of pixels of every frame's plane, uint8 [frames, n], for `lamp_ratio`."""
    return None if off is None else _samples(on, off)


def _samples(on: Array, off: Array) -> tuple[Array, Array]:
    steps = [max(1, size // looks) for size, looks in zip(on.shape[1:], _LOOKS, strict=True)]
    first, second = (frames[:, :: steps[0], :: steps[1]] for frames in (on, off))
    return first.reshape(len(on), -1), second.reshape(len(on), -1)


def _ratios(pair: tuple[Array, Array] | None, search: Search, frames: int) -> Float[Array, " frames"]:
    if pair is None:
        return jnp.ones(frames, jnp.float32)
    return applied_ratio(lamp_ratio(*pair, search.read_dn, search.electrons_per_dn)).astype(jnp.float32)


_compiled_ratios = jax.jit(_ratios, static_argnums=2)
