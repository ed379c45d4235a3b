"""The normal equations of a block arrow, and their solution by Schur's complement.

The shared unknowns meet every residual, a board's pose only those of its own placement.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry import Array


class Blocks(NamedTuple):
    """J'J and J'r of the block arrow."""

    shared: Float[Array, "shared shared"]
    cross: Float[Array, "placements shared 6"]
    local: Float[Array, "placements 6 6"]
    shared_gradient: Float[Array, " shared"]
    local_gradient: Float[Array, "placements 6"]


def schur_step(
    blocks: Blocks, damping: Float[Array, ""]
) -> tuple[Float[Array, " shared"], Float[Array, "placements 6"]]:
    """Solve (J'J + damping diag(J'J)) step = J'r."""
    reduced, coupling, rhs, local = reduce_blocks(blocks, damping)
    factor = jnp.linalg.cholesky(reduced)
    shared = jax.scipy.linalg.cho_solve((factor, True), rhs)
    return shared, local - jnp.einsum("vdk,k->vd", coupling, shared)


def reduce_blocks(
    blocks: Blocks, damping: Float[Array, ""]
) -> tuple[
    Float[Array, "shared shared"],
    Float[Array, "placements 6 shared"],
    Float[Array, " shared"],
    Float[Array, "placements 6"],
]:
    """Eliminate the poses.

    Returns:
        reduced: Information of the shared unknowns, S = U - sum W V^-1 W'.
        coupling: V^-1 W' of every placement.
        rhs: Right hand side that belongs to S.
        local: V^-1 b of every placement.
    """
    factors = jax.vmap(lambda v: jnp.linalg.cholesky(v + jnp.diag(_damped(jnp.diag(v), damping))))(blocks.local)
    solve_local = jax.vmap(lambda factor, b: jax.scipy.linalg.cho_solve((factor, True), b))
    coupling = solve_local(factors, jnp.swapaxes(blocks.cross, 1, 2))
    local = solve_local(factors, blocks.local_gradient)
    reduced = blocks.shared + jnp.diag(_damped(jnp.diag(blocks.shared), damping))
    reduced = reduced - jnp.einsum("vkd,vdj->kj", blocks.cross, coupling)
    rhs = blocks.shared_gradient - jnp.einsum("vkd,vd->k", blocks.cross, local)
    return reduced, coupling, rhs, local


def _damped(diagonal: Float[Array, " n"], damping: Float[Array, ""]) -> Float[Array, " n"]:
    # Held parameters and padding have empty columns; a 1 keeps the matrix regular and their step 0.
    return jnp.where(diagonal > 0, damping * diagonal, 1.0).astype(diagonal.dtype)
