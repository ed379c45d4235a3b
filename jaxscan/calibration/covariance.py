"""What the observations say at the minimum: information, covariance, leverages, weak directions."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.residuals import Measured, Problem, Residuals, measure
from jaxscan.calibration.solve import Columns, form_blocks, jacobian_columns, reduce_blocks, zero_step
from jaxscan.geometry import Array


class Linearised(NamedTuple):
    """The problem at its minimum, to first order; scaled unknowns."""

    residual: Residuals
    measured: Measured
    corner_leverage: Float[Array, "views rows"]
    """Share of each whitened residual that the fit takes up, 0 ... 1 [1]."""
    stripe_leverage: Float[Array, "stripes points"]
    reduced: Float[Array, "shared shared"]
    """Information of the shared unknowns, poses eliminated; 1 on the diagonal of held ones."""
    prior: Float[Array, "shared shared"]
    """The part of it that comes from the priors."""


@eqx.filter_jit
def linearise(problem: Problem) -> Linearised:
    """Information and leverages, undamped; call in 64 bit."""
    start = zero_step(problem)
    residual, product, measured = jax.linearize(lambda step: measure(step, problem), start, has_aux=True)
    corner, stripe, prior = jacobian_columns(product, start)
    view_owner, stripe_owner = problem.placement, problem.placement[problem.stripe_view]
    blocks = form_blocks(corner, stripe, prior, residual, view_owner, stripe_owner, problem.poses.shape[0])
    reduced, coupling, _, _ = reduce_blocks(blocks, jnp.zeros((), start.shared.dtype))
    shared_covariance = jnp.linalg.inv(reduced)
    empty = jnp.diagonal(blocks.local, axis1=1, axis2=2) == 0
    filled = blocks.local + jax.vmap(jnp.diag)(empty.astype(reduced.dtype))
    cross_covariance = -jnp.einsum("kj,vdj->vkd", shared_covariance, coupling)
    local_covariance = jnp.linalg.inv(filled) - jnp.einsum("vdk,vke->vde", coupling, cross_covariance)

    def leverage(columns: Columns, owner: Array) -> Array:
        share = jnp.einsum("kvm,kj,jvm->vm", columns.shared, shared_covariance, columns.shared)
        share = share + 2.0 * jnp.einsum("kvm,vkd,dvm->vm", columns.shared, cross_covariance[owner], columns.local)
        return share + jnp.einsum("dvm,vde,evm->vm", columns.local, local_covariance[owner], columns.local)

    return Linearised(
        residual, measured, leverage(corner, view_owner), leverage(stripe, stripe_owner), reduced, prior @ prior.T
    )


class Determination(NamedTuple):
    """How well the shared unknowns are known."""

    covariance: np.ndarray
    """[shared, shared], in px, rad, m; zero for held unknowns."""
    condition: float
    """Condition number of the information scaled to a unit diagonal."""
    unobserved: list[dict[str, float]]
    """Directions that the priors know better than the data: parameter -> component, in units of
    its standard deviation."""
    prior_share: float
    """Largest share of the information in any one direction that is the priors' own."""


def determine(
    reduced: np.ndarray, prior: np.ndarray, scales: np.ndarray, names: tuple[str, ...]
) -> Determination | None:
    """Covariance of the shared unknowns from their information; None if it is singular."""
    free = np.flatnonzero(scales)
    covariance = np.zeros_like(reduced)
    if len(free) == 0:
        return Determination(covariance, 1.0, [], 0.0)
    information = reduced[np.ix_(free, free)]
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    if not np.all(np.isfinite(information)) or np.any(size == 0):
        return None
    eigenvalues = np.linalg.eigvalsh(information / np.outer(size, size))
    if eigenvalues[0] <= len(free) * np.finfo(float).eps:
        return None
    inverse = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    covariance[np.ix_(free, free)] = inverse * np.outer(scales[free], scales[free])
    # Shares of the prior in the information: generalised eigenvalues, 0 (data only) ... 1.
    root = np.linalg.cholesky(inverse)
    shares, vectors = np.linalg.eigh(root.T @ prior[np.ix_(free, free)] @ root)
    sigma = np.sqrt(np.diag(inverse))
    unobserved = []
    for share, vector in zip(shares, vectors.T, strict=True):
        if share > 0.5:
            direction = (root @ vector) / sigma
            largest = np.argsort(-np.abs(direction))[:3]
            unobserved.append(
                {names[free[i]]: round(float(direction[i]), 3) for i in largest if abs(direction[i]) > 0.1}
            )
    return Determination(covariance, float(eigenvalues[-1] / eigenvalues[0]), unobserved, float(shares[-1]))
