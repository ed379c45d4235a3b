"""A frame's samples of the laser's colour: a plane for what looks at all, places in a stack's bytes for what looks at a
few."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Int, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames import LaserLine, PixelFormat, laser_plane, laser_sites


class Plane(NamedTuple):
    """The samples of the laser's colour in one frame."""

    samples: UInt8[Array, "lines samples"]
    stack: UInt8[Array, " bytes"]
    """What the frame is cut out of. A gather from it keeps loops from copying the frame."""
    first: Int[Array, " lines"]
    """Where the first sample of every line is in the stack."""
    step: int
    """Bytes from sample to sample."""

    @classmethod
    def of(cls, samples: UInt8[Array, "lines samples"]) -> "Plane":
        """A plane from samples that are at hand."""
        lines, count = samples.shape
        return cls(samples, jnp.asarray(samples).reshape(-1), count * np.arange(lines, dtype=np.int32), 1)

    def at(self, line: Int[Array, "*#n"], sample: Int[Array, "*n"]) -> UInt8[Array, "*n"]:
        """Samples within the plane."""
        place = jnp.asarray(self.first)[line] + self.step * sample
        return jnp.asarray(self.stack).at[place].get(mode="promise_in_bounds")


def plane_of(
    stack: UInt8[Array, " bytes"],
    start: Int[Array, ""],
    shape: tuple[int, ...],
    pixel_format: PixelFormat,
    line: LaserLine,
) -> Plane:
    """The plane of the frame that begins at `start` of a stack; `shape` is [rows, columns] (rgb8: and 3)."""
    size = int(np.prod(shape))
    frame = lax.dynamic_slice(stack, (start,), (size,)).reshape(1, *shape)
    samples = laser_plane(frame, pixel_format=pixel_format, line=line)[0]
    lines = samples.shape[0]
    sites = laser_sites(pixel_format, line)
    across, along = (1, shape[1]) if line.stripe_axis == "rows" else (shape[1], 1)
    each, channel = (3, ("red", "green", "blue").index(str(line.colour))) if pixel_format == "rgb8" else (1, 0)
    offset = np.asarray(sites.offsets)[np.arange(lines) % len(sites.offsets)]
    first = each * ((sites.first_line + sites.line_step * np.arange(lines)) * along + offset * across) + channel
    return Plane(samples, stack, start + first.astype(np.int32), each * across * sites.pitch)
