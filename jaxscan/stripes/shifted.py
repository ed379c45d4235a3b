"""Frames that start anywhere in aligned memory.

On a CPU JAX takes an array without a copy only where its address is a multiple of 64 bytes, which
large NumPy arrays hardly ever are. The memory around such frames can be taken all the same.
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Int, UInt8

from jaxscan.geometry import Array


class Shifted(eqx.Module):
    """Frames [frames, rows, columns], or one of them, `lead` bytes from the start of `memory`."""

    memory: UInt8[Array, " bytes"]
    lead: Int[Array, "..."]
    shape: tuple[int, ...] = eqx.field(static=True)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, number: Int[Array, "..."]) -> "Shifted":
        """One of the frames."""
        inner = self.shape[1:]
        return Shifted(self.memory, self.lead + math.prod(inner) * number, inner)

    def array(self) -> UInt8[Array, "rows columns"]:
        """A single frame as an array."""
        return lax.dynamic_slice(self.memory, (self.lead,), (math.prod(self.shape),)).reshape(self.shape)

    def pixel(self, row: Int[Array, ""], column: Int[Array, ""]) -> UInt8[Array, ""]:
        """One pixel of a single frame, which must be inside."""
        index = self.lead + self.shape[1] * row + column
        return jnp.asarray(self.memory).at[index].get(mode="promise_in_bounds")


Frames = Array | Shifted
