"""What the solver asks of a problem: residuals, and the normal equations that belong to them.

Shared unknowns (a camera, a scanner) may meet every residual; an owner of residuals (a view, a point on a plane)
meets one block (the pose of a board, the plane) beside them, or none.
"""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float, Int

from jaxscan.geometry import Array
from jaxscan.leastsq.arrow import Arrow


class Unknowns(NamedTuple):
    """Values, or a step, of all unknowns."""

    shared: Float[Array, " shared"]
    local: Float[Array, "blocks own"]


class Linear(NamedTuple):
    """A problem at a point, to first order."""

    arrow: Arrow
    """The normal equations J'J and J'r."""
    more: Any
    """Anything that the end of a solve should have beside them; a tree of arrays."""


class AbstractProblem(eqx.Module):
    """What the solver asks of a problem."""

    @abc.abstractmethod
    def linearise(self, y: Any) -> tuple[Any, Linear]:
        """Whitened residuals at a point, a tree of arrays, and the problem to first order there."""

    @abc.abstractmethod
    def move(self, y: Any, step: Unknowns) -> Any:
        """The point to which a step of the arrow's unknowns leads."""


class Normal(NamedTuple):
    """The parts of owners in the normal equations, by the shared unknowns and then by the one block that each meets."""

    square: Float[Array, "owners numbers numbers"]
    """J'J of the owner's whitened residuals."""
    gradient: Float[Array, "owners numbers"]
    """J'r."""
    block: Int[Array, " owners"] | None = None
    """Which block; None where they meet none, and have no derivatives by one."""
    chain: Float[Array, "owners numbers unknowns"] | None = None
    """Where J has derivatives by other numbers of the owner: those of these by the unknowns. Thousands of residuals
    may share a few such numbers."""


def sum_arrow(parts: Sequence[Normal], shared: int, blocks: tuple[int, int]) -> Arrow:
    """J'J and J'r of all owners."""
    count, own = blocks
    dtype = parts[0].square.dtype
    matrix, gradient = jnp.zeros((shared, shared), dtype), jnp.zeros(shared, dtype)
    whole, right = jnp.zeros((count, shared + own, shared + own), dtype), jnp.zeros((count, shared + own), dtype)
    for square, times, block, chain in parts:
        if chain is not None:
            follow = jnp.swapaxes(chain, 1, 2)
            square, times = follow @ square @ chain, (follow @ times[..., None])[..., 0]
        if block is None:
            matrix, gradient = matrix + square.sum(0), gradient + times.sum(0)
        else:
            whole, right = whole.at[block].add(square), right.at[block].add(times)
    return Arrow(
        matrix + whole[:, :shared, :shared].sum(0),
        whole[:, :shared, shared:],
        whole[:, shared:, shared:],
        gradient + right[:, :shared].sum(0),
        right[:, shared:],
    )
