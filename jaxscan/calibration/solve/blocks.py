"""The normal equations of a block arrow, their solution and their inverse by Schur's complement; on the host.

The shared unknowns meet every residual, a board's pose only those of its own placement.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Blocks(NamedTuple):
    """J'J and J'r of the block arrow."""

    shared: Float[np.ndarray, "shared shared"]
    cross: Float[np.ndarray, "placements shared 6"]
    local: Float[np.ndarray, "placements 6 6"]
    shared_gradient: Float[np.ndarray, " shared"]
    local_gradient: Float[np.ndarray, "placements 6"]


class Reduced(NamedTuple):
    """The normal equations of the shared unknowns, poses eliminated."""

    information: Float[np.ndarray, "shared shared"]
    """S = U - sum W V^-1 W'."""
    gradient: Float[np.ndarray, " shared"]
    """Right hand side that belongs to S."""
    coupling: Float[np.ndarray, "placements 6 shared"]
    """V^-1 W' of every placement."""
    local: Float[np.ndarray, "placements 6"]
    """V^-1 b of every placement."""


class Inverse(NamedTuple):
    """The inverse of J'J, by blocks."""

    shared: Float[np.ndarray, "shared shared"]
    cross: Float[np.ndarray, "placements shared 6"]
    local: Float[np.ndarray, "placements 6 6"]

    def of(self, owner: Int[np.ndarray, " owners"]) -> Float[np.ndarray, "owners unknowns unknowns"]:
        """Covariance of the shared unknowns together with the pose of each owner."""
        shared = np.broadcast_to(self.shared[None], (len(owner), *self.shared.shape))
        cross = self.cross[owner]
        return np.block([[shared, cross], [np.swapaxes(cross, 1, 2), self.local[owner]]])


def reduce_blocks(blocks: Blocks, damping: float) -> Reduced:
    """Eliminate the poses from (J'J + damping diag(J'J)) step = J'r."""
    upright = np.swapaxes(blocks.cross, 1, 2)
    right = np.concatenate([upright, blocks.local_gradient[..., None]], axis=2)
    solved = np.linalg.solve(_damped(blocks.local, damping), right)
    coupling, local = solved[..., :-1], solved[..., -1]
    information = _damped(blocks.shared, damping) - np.tensordot(blocks.cross, coupling, ((0, 2), (0, 1)))
    gradient = blocks.shared_gradient - np.tensordot(blocks.cross, local, ((0, 2), (0, 1)))
    return Reduced(information, gradient, coupling, local)


def schur_step(
    blocks: Blocks, damping: float
) -> tuple[Float[np.ndarray, " shared"], Float[np.ndarray, "placements 6"]]:
    """Solve (J'J + damping diag(J'J)) step = J'r."""
    reduced = reduce_blocks(blocks, damping)
    factor = np.linalg.cholesky(reduced.information)
    shared = np.linalg.solve(factor.T, np.linalg.solve(factor, reduced.gradient))
    return shared, reduced.local - reduced.coupling @ shared


def inverse_blocks(blocks: Blocks) -> Inverse:
    """Covariances of the unknowns from the blocks of J'J; of what meets nothing, 1."""
    reduced = reduce_blocks(blocks, 0.0)
    shared = np.linalg.inv(reduced.information)
    cross = -shared @ np.swapaxes(reduced.coupling, 1, 2)
    return Inverse(shared, cross, np.linalg.inv(_damped(blocks.local, 0.0)) - reduced.coupling @ cross)


def _damped(matrix: Float[np.ndarray, "... n n"], damping: float) -> Float[np.ndarray, "... n n"]:
    # Held parameters and padding have empty columns; a 1 keeps the matrix regular and their step 0.
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    return matrix + np.where(diagonal > 0, damping * diagonal, 1.0)[..., None] * np.eye(matrix.shape[-1])
