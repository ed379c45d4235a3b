"""The normal equations of a block arrow and their solution; what the solver asks of a problem that has such equations.

Shared unknowns meet every residual, those of a block (a board's pose, a plane, a point, a station) only residuals of
their own, so that blocks are eliminated one by one, by Schur's complement. In NumPy on the host, or in JAX inside of a
compiled solve.

Source: Triggs et al., Bundle adjustment: a modern synthesis (2000), section 6.
"""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Array, namespace


# From this number of shared unknowns on the time of an inverse matters.
_MANY = 500
# Eigenvalue of the information, scaled to a unit diagonal, that is rounding error: sums of some ten
# thousand squares lose three digits, and inverting costs some more.
_SINGULAR = 1e-11


class Arrow(NamedTuple):
    """J'J and J'r by blocks."""

    shared: Float[Array, "shared shared"]
    cross: Float[Array, "blocks shared own"]
    local: Float[Array, "blocks own own"]
    shared_gradient: Float[Array, " shared"]
    local_gradient: Float[Array, "blocks own"]


class Reduced(NamedTuple):
    """The normal equations of the shared unknowns, blocks eliminated."""

    information: Float[Array, "shared shared"]
    """S = U - sum W V^-1 W'; 1 on the diagonal of unknowns that meet nothing."""
    gradient: Float[Array, " shared"]
    """Right hand side that belongs to S."""
    coupling: Float[Array, "blocks own shared"]
    """V^-1 W' of every block."""
    local: Float[Array, "blocks own"]
    """V^-1 b of every block."""


class Covariance(NamedTuple):
    """The inverse of J'J, by blocks; NumPy. Unknowns that meet nothing have variance 1, and are independent."""

    information: Float[np.ndarray, "shared shared"]
    """Information on the shared unknowns, with all blocks free."""
    shared: Float[np.ndarray, "shared shared"]
    coupling: Float[np.ndarray, "blocks own shared"]
    """How blocks follow the shared unknowns, with a minus."""
    alone: Float[np.ndarray, "blocks own own"]
    """Covariance of the blocks for fixed shared unknowns."""

    @property
    def cross(self) -> Float[np.ndarray, "blocks shared own"]:
        """Between the shared unknowns and each block."""
        return -self.shared @ np.swapaxes(self.coupling, 1, 2)

    def of(self, owner: Int[np.ndarray, " owners"]) -> Float[np.ndarray, "owners unknowns unknowns"]:
        """Covariance of the shared unknowns together with the block of each owner."""
        cross = self.cross
        local = self.alone - self.coupling @ cross
        shared = np.broadcast_to(self.shared[None], (len(owner), *self.shared.shape))
        cross = cross[owner]
        return np.block([[shared, cross], [np.swapaxes(cross, 1, 2), local[owner]]])

    def step(self, arrow: Arrow) -> tuple[Float[np.ndarray, " shared"], Float[np.ndarray, "blocks own"]]:
        """Solve J'J step = J'r, with the right-hand side of an arrow."""
        local = np.einsum("bij,bj->bi", self.alone, np.asarray(arrow.local_gradient))
        shared = self.shared @ (arrow.shared_gradient - _joined(np.asarray(arrow.cross)) @ local.ravel())
        return shared, local - self.coupling @ shared


def reduce_arrow(arrow: Arrow, damping: float | Float[Array, ""] = 0.0) -> Reduced:
    """Eliminate the blocks from (J'J + damping diag(J'J)) step = J'r."""
    xp = namespace(arrow)
    upright = xp.swapaxes(arrow.cross, 1, 2)
    right = xp.concatenate([upright, arrow.local_gradient[..., None]], axis=2)
    solved = _solve(xp, _damped(xp, arrow.local, damping), right)
    coupling, local = solved[..., :-1], solved[..., -1]
    beside = _joined(arrow.cross)
    information = _damped(xp, arrow.shared, damping) - beside @ coupling.reshape(-1, len(arrow.shared))
    return Reduced(information, arrow.shared_gradient - beside @ local.reshape(-1), coupling, local)


def solve_arrow(
    arrow: Arrow, damping: float | Float[Array, ""] = 0.0
) -> tuple[Float[Array, " shared"], Float[Array, "blocks own"]]:
    """Solve (J'J + damping diag(J'J)) step = J'r; in JAX the step is NaN if rounding left no positive matrix."""
    xp, reduced = namespace(arrow), reduce_arrow(arrow, damping)
    shared = _solve(xp, reduced.information, reduced.gradient[:, None])[:, 0]
    return shared, reduced.local - reduced.coupling @ shared


def arrow_times(
    arrow: Arrow, shared: Float[Array, " shared"], local: Float[Array, "blocks own"]
) -> tuple[Float[Array, " shared"], Float[Array, "blocks own"]]:
    """J'J times a step."""
    beside = _joined(arrow.cross)
    own = (arrow.local @ local[..., None])[..., 0]
    return arrow.shared @ shared + beside @ local.reshape(-1), own + (shared @ beside).reshape(local.shape)


def covariance_of(arrow: Arrow) -> Covariance:
    """The inverse of J'J, by blocks; on the host.

    Raises:
        LinAlgError: If the residuals leave a combination of unknowns undetermined.
    """
    arrow = Arrow(*map(np.asarray, arrow))
    information, _, coupling, _ = map(np.asarray, reduce_arrow(arrow))
    alone = np.linalg.inv(_damped(np, arrow.local, 0.0))
    return Covariance(information, _inverse(information), coupling, alone)


def undetermined(arrow: Arrow, among: Int[np.ndarray, " some"]) -> Float[np.ndarray, " some"]:
    """Length of each of some shared unknowns' part in the null space of their information, 0 ... 1; on the host.

    All 0 where the information is regular. The whole null space counts: which of its vectors come
    out of a decomposition is a matter of rounding.
    """
    # The information after the blocks are eliminated is compared with that before: where nothing
    # is left, rounding error remains.
    known = np.sqrt(np.diagonal(arrow.shared)[among])
    if np.any(known == 0):
        return (known == 0).astype(float)
    information = np.asarray(reduce_arrow(arrow).information)[np.ix_(among, among)]
    values, vectors = np.linalg.eigh(information / np.outer(known, known))
    return np.asarray(np.linalg.norm(vectors[:, values <= _SINGULAR], axis=1))


def _inverse(information: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    size = 1.0 / np.sqrt(np.diag(information))
    scaled = information * np.outer(size, size)
    if len(size) > _MANY:
        inverse = np.linalg.inv(scaled) * np.outer(size, size)
        return (inverse + inverse.T) / 2
    # The product of a matrix and its transpose is symmetric to the last digit, however weak a direction is.
    half = np.linalg.inv(np.linalg.cholesky(scaled)) * size[None, :]
    return half.T @ half


def _joined(cross: Float[Array, "blocks shared own"]) -> Float[Array, "shared blocks_times_own"]:
    """One matrix of all blocks, whose products take one call of BLAS."""
    return namespace(cross).swapaxes(cross, 0, 1).reshape(cross.shape[1], -1)


def _damped(xp: Any, matrix: Float[Array, "... n n"], damping: float | Float[Array, ""]) -> Float[Array, "... n n"]:
    # Held unknowns and padding have empty columns; a 1 keeps the matrix regular and their step 0.
    diagonal = xp.diagonal(matrix, axis1=-2, axis2=-1)
    added = xp.where(diagonal > 0, damping * diagonal, 1.0).astype(matrix.dtype)
    return matrix + added[..., None] * xp.broadcast_to(xp.eye(matrix.shape[-1], dtype=matrix.dtype), matrix.shape)


def _solve(xp: Any, matrix: Float[Array, "... n n"], right: Float[Array, "... n m"]) -> Float[Array, "... n m"]:
    """Solve with symmetric positive matrices."""
    if xp is np:
        return np.linalg.solve(matrix, right)
    return jsl.cho_solve((jnp.linalg.cholesky(matrix), True), right)


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
    """The block of each owner; None where they meet none, and have no derivatives by one."""
    chain: Float[Array, "owners numbers unknowns"] | None = None
    """Derivatives of the owner's numbers by the unknowns, where J has derivatives by such numbers. Thousands of
    residuals may share a few of them."""


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
