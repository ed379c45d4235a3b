"""The least-squares solve: optimistix' loop and trust region round the block elimination."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.solve import BlockArrowLM
from jaxscan.geometry import Array
from jaxscan.recalibration.adjust.blocks import Blocks, form_blocks, reduce_blocks, solve_blocks, zero_blocks
from jaxscan.recalibration.adjust.residuals import residuals
from jaxscan.recalibration.adjust.room import Room, Unknowns
from jaxscan.recalibration.adjust.rows import Rows, places_in_surfaces, point_rows, sighting_rows


class Solution(NamedTuple):
    """The end of a solve."""

    y: Unknowns
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


class RoomDescent(optx.AbstractDescent):
    """Damped step (J'J + lambda diag(J'J))^-1 J'r by Schur's complement."""

    room: Room
    damping: Float[Array, ""]
    """Of the first step, relative to the diagonal of J'J."""

    def init(self, y: Unknowns, f_info_struct: Any) -> tuple[Unknowns, Blocks]:
        return y, zero_blocks(y, len(self.room.lengths.metres))

    def query(self, y: Unknowns, f_info: Any, state: Any) -> tuple[Unknowns, Blocks]:
        return y, form_blocks(self.room, y, f_info.residual)

    def step(self, step_size: Any, state: tuple[Unknowns, Blocks]) -> tuple[Unknowns, Any]:
        step = solve_blocks(self.room, *state, self.damping / step_size)
        return jax.tree.map(jnp.negative, step), optx.RESULTS.successful


@eqx.filter_jit
def solve(room: Room, y: Unknowns, limits: tuple[Array, Array], max_steps: int) -> Solution:
    """Minimise the sum of squares of `residuals`; call in 64 bit.

    Args:
        room: With its weights.
        y: Where to begin.
        limits: Damping of the first step, relative to the diagonal of J'J, and the root mean square change of
            unknowns and whitened residuals at which to stop [1].
        max_steps: Steps at most.
    """
    damping, tolerance = limits
    solver = BlockArrowLM(descent=RoomDescent(room, damping), rtol=tolerance, atol=tolerance)
    solution: Any = optx.least_squares(residuals, solver, y, args=room, max_steps=max_steps, throw=False)
    return Solution(
        solution.value, solution.stats["num_steps"], jnp.asarray(solution.result == optx.RESULTS.successful)
    )


class Linearised(NamedTuple):
    """The problem to first order at a step."""

    points: Rows
    place: Float[Array, "points 2"]
    """Coordinates of the points in their planes [m]."""
    sightings: Rows
    reduced: Float[Array, "dense dense"]
    """Information of the dense unknowns; 1 on the diagonal of those that are held."""
    covariance: Float[Array, "dense dense"]
    """Its inverse."""
    coupling: Float[Array, "locals 3 dense"]
    local: Float[Array, "locals 3 3"]
    """Covariance of surfaces and tracked points if the dense unknowns were known."""


@eqx.filter_jit
def linearise(room: Room, y: Unknowns) -> Linearised:
    """Errors, information and covariance at a step; call in 64 bit."""
    zero = jax.tree.map(jnp.zeros_like, residuals(y, room))
    blocks = form_blocks(room, y, zero)
    reduced = reduce_blocks(blocks, jnp.zeros((), y.scanner.dtype))
    size = 1.0 / jnp.sqrt(jnp.diagonal(reduced.matrix))
    factor = jnp.linalg.cholesky(reduced.matrix * size[:, None] * size[None, :])
    half = jax.scipy.linalg.solve_triangular(factor, jnp.diag(size), lower=True)
    empty = jnp.diagonal(blocks.local, axis1=1, axis2=2) == 0
    local = jnp.linalg.inv(blocks.local + jax.vmap(jnp.diag)(empty.astype(size.dtype)))
    return Linearised(
        point_rows(room, y),
        places_in_surfaces(room, y),
        sighting_rows(room, y),
        reduced.matrix,
        half.T @ half,
        reduced.coupling,
        local,
    )


def on_host(tree: Any) -> Any:
    """The same arrays in NumPy."""
    return jax.tree.map(np.asarray, tree)
