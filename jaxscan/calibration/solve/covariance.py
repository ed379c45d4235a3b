"""Information of the observations at the minimum, covariance, leverages, weak directions."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.parameters import is_mode
from jaxscan.calibration.solve.blocks import Blocks, reduce_blocks
from jaxscan.calibration.solve.problem import Problem, Step, camera_from_board, move, zero_step
from jaxscan.calibration.solve.residuals import priors
from jaxscan.calibration.solve.rows import Departures, corner_rows, departures, stripe_rows
from jaxscan.geometry import Array


# Directions of which the priors know less than this share are the data's alone.
_LEAST_SHARE = 1e-6
# Eigenvalue of the information, scaled to a unit diagonal, that is rounding error: sums of some ten
# thousand squares lose three digits, and inverting costs some more.
_SINGULAR = 1e-11


class Linearised(NamedTuple):
    """The problem at its minimum, to first order; scaled unknowns."""

    corner_error: Float[Array, "views rows"]
    """Projected minus observed corners, u and v of each [px]."""
    offset: Float[Array, "stripes points"]
    """Distance e of a stripe point, lifted to its board, from its sheet [m]."""
    slope: Float[Array, "stripes points"]
    """|grad_q e|: change of the distance over one pixel across the stripe [m / px]."""
    prior_residual: Float[Array, " shared"]
    corner_leverage: Float[Array, "views rows"]
    """Share of each whitened residual that the fit takes up, 0 ... 1 [1]."""
    stripe_leverage: Float[Array, "stripes points"]
    reduced: Float[Array, "shared shared"]
    """Information of the shared unknowns, poses eliminated; 1 on the diagonal of held ones."""
    prior: Float[Array, "shared shared"]
    """The part of it that comes from the priors."""
    known_poses: Float[Array, " shared"]
    """Diagonal of the information that there would be if all poses were known."""
    view_poses: Float[Array, "views 4 4"]
    """T_cam(phi)_board of every view."""
    by_q: Float[Array, "stripes points 2"]
    """grad_q e [m / px]."""
    corner_slopes: Float[Array, "views rows departures"]
    """Derivatives of the whitened rows by the departures of their view."""
    stripe_slopes: Float[Array, "stripes points departures"]
    corner_chain: Float[Array, "unknowns views departures"]
    """Derivatives of the departures by the shared unknowns and the pose of the view."""
    stripe_chain: Float[Array, "unknowns stripes departures"]
    blocks: Blocks
    """The normal equations."""
    cost: Float[Array, ""]
    """Half the sum of squares of all whitened residuals, priors included [1]."""


def linearise(problem: Problem) -> Linearised:
    """Errors, information and leverages at the point that the problem holds; traceable, in 64 bit."""
    corners, (stripes, by_q) = corner_rows(problem), stripe_rows(problem)
    corner_weight, stripe_weight = jnp.repeat(problem.corner_weight, 2, axis=1), problem.stripe_weight
    corner_slopes = corners.slopes * corner_weight[..., None]
    stripe_slopes = stripes.slopes * stripe_weight[..., None]
    chain = chains(problem)
    prior_residual, prior_slopes = prior_rows(problem)
    prior = prior_slopes.T @ prior_slopes
    view_owner, stripe_owner = problem.placement, problem.stripe_placement()
    corner, stripe = corners.value * corner_weight, stripes.value * stripe_weight
    own = tuple(
        Normal(gram(slopes, chain), gradient(slopes, chain, values))
        for slopes, chain, values in (
            (corner_slopes, chain.corner, corner),
            (stripe_slopes, chain.stripe, stripe),
        )
    )
    priors_own = Normal(prior, prior_slopes.T @ prior_residual)
    blocks = sum_blocks(own, priors_own, (view_owner, stripe_owner), len(problem.poses))
    information = inverse_blocks(blocks)

    def leverage(slopes: Array, chain: Array, owner: Array) -> Array:
        # The covariance of a view's departures, then that of each row.
        own = information.of(owner)
        small = jnp.einsum("kvd,vkj,jve->vde", chain, own, chain)
        return jnp.einsum("vrd,vde,vre->vr", slopes, small, slopes)

    return Linearised(
        corners.value,
        stripes.value,
        jnp.linalg.norm(by_q, axis=-1),
        prior_residual,
        leverage(corner_slopes, chain.corner, view_owner),
        leverage(stripe_slopes, chain.stripe, stripe_owner),
        information.reduced,
        prior,
        jnp.diagonal(blocks.shared),
        camera_from_board(problem),
        by_q,
        corner_slopes,
        stripe_slopes,
        chain.corner,
        chain.stripe,
        blocks,
        0.5 * (jnp.sum(corner**2) + jnp.sum(stripe**2) + jnp.sum(prior_residual**2)),
    )


def chains(problem: Problem) -> Departures:
    """Derivatives of the departures by the shared unknowns and their own pose [unknowns, owners, departures]."""
    start = zero_step(problem)
    count = len(start.shared)
    product = jax.linearize(lambda step: departures(step, problem), start)[1]
    # Behind the barrier, or the compiler works out products with these constants itself, slowly.
    unit = jax.lax.optimization_barrier(jnp.eye(count + 6, dtype=start.shared.dtype))
    # Poses of different placements meet different views, so all are moved at once.
    return jax.vmap(lambda e: product(Step(e[:count], jnp.broadcast_to(e[None, count:], start.local.shape))))(unit)


def gram(slopes: Float[Array, "owners rows departures"], chain: Float[Array, "unknowns owners departures"]) -> Array:
    """J'J of every view or stripe, by the shared unknowns and its pose [owners, unknowns, unknowns]."""
    small = jnp.einsum("vrd,vre->vde", slopes, slopes)
    return jnp.einsum("kvd,vde,jve->vkj", chain, small, chain)


def gradient(
    slopes: Float[Array, "owners rows departures"],
    chain: Float[Array, "unknowns owners departures"],
    values: Float[Array, "owners rows"],
) -> Array:
    """J'r of every view or stripe, by the shared unknowns and its pose [owners, unknowns]."""
    return jnp.einsum("kvd,vd->vk", chain, jnp.einsum("vrd,vr->vd", slopes, values))


def prior_rows(problem: Problem) -> tuple[Float[Array, " shared"], Float[Array, "shared shared"]]:
    """Residuals of the priors, and their derivatives by the scaled shared unknowns."""
    start = zero_step(problem)
    move_priors = lambda shared: priors(move(Step(shared, start.local), problem))
    return priors(problem), jax.jacfwd(move_priors)(start.shared)


class Inverse(NamedTuple):
    """The inverse of J'J, by blocks."""

    reduced: Float[Array, "shared shared"]
    shared: Float[Array, "shared shared"]
    cross: Float[Array, "placements shared 6"]
    local: Float[Array, "placements 6 6"]

    def of(self, owner: Int[Array, " owners"]) -> Float[Array, "owners unknowns unknowns"]:
        """Covariance of the shared unknowns together with the pose of each owner."""
        shared = jnp.broadcast_to(self.shared[None], (owner.shape[0], *self.shared.shape))
        cross = self.cross[owner]
        return jnp.concatenate(
            [
                jnp.concatenate([shared, cross], axis=2),
                jnp.concatenate([jnp.swapaxes(cross, 1, 2), self.local[owner]], axis=2),
            ],
            axis=1,
        )


def inverse_blocks(blocks: Blocks) -> Inverse:
    """Covariances of the unknowns from the blocks of J'J."""
    reduced, coupling, _, _ = reduce_blocks(blocks, jnp.zeros((), blocks.shared.dtype))
    shared = jnp.linalg.inv(reduced)
    empty = jnp.diagonal(blocks.local, axis1=1, axis2=2) == 0
    filled = blocks.local + jax.vmap(jnp.diag)(empty.astype(reduced.dtype))
    cross = -jnp.einsum("kj,vdj->vkd", shared, coupling)
    return Inverse(reduced, shared, cross, jnp.linalg.inv(filled) - jnp.einsum("vdk,vke->vde", coupling, cross))


class Normal(NamedTuple):
    """Normal equations of every view or stripe, or of the priors."""

    information: Float[Array, "... unknowns unknowns"]
    gradient: Float[Array, "... unknowns"]


def sum_blocks(every: tuple[Normal, ...], prior: Normal, owners: tuple[Array, ...], placements: int) -> Blocks:
    """J'J and J'r from those of every view and stripe, with their placements, and of the priors."""
    count = len(prior.gradient)

    def total(field: str) -> Array:
        parts = [getattr(normal, field) for normal in every]
        result = jnp.zeros((placements, *parts[0].shape[1:]), parts[0].dtype)
        for part, owner in zip(parts, owners, strict=True):
            result = result.at[owner].add(part)
        return result

    own, gradient = total("information"), total("gradient")
    return Blocks(
        own[:, :count, :count].sum(0) + prior.information,
        own[:, :count, count:],
        own[:, count:, count:],
        gradient[:, :count].sum(0) + prior.gradient,
        gradient[:, count:],
    )


class Determination(NamedTuple):
    """How well the shared unknowns are known."""

    covariance: np.ndarray
    """[shared, shared], in px, rad, m; zero for held unknowns."""
    condition: float
    """Condition number of the information scaled to a unit diagonal."""
    spectrum: tuple[tuple[float, dict[str, float]], ...]
    """Independent directions that priors speak of: the standard deviation along each over that of
    its prior [1], and its largest components by name, in units of their standard deviations."""
    prior_share: float
    """Largest share of the information in any one direction that is the priors' own."""


def undetermined_shares(linearised: Linearised, scales: np.ndarray) -> np.ndarray:
    """Length of each shared unknown's part in the null space of the information [shared], 0 ... 1.

    All 0 where the information is regular. The whole null space counts: which of its vectors come
    out of a decomposition is a matter of rounding.
    """
    free = np.flatnonzero(scales)
    # The information after the poses are eliminated is compared with that before: where nothing
    # is left, rounding error remains.
    known = np.sqrt(np.asarray(linearised.known_poses)[free])
    shares = np.zeros(len(scales))
    if np.any(known == 0):
        shares[free] = known == 0
        return shares
    values, vectors = np.linalg.eigh(np.asarray(linearised.reduced)[np.ix_(free, free)] / np.outer(known, known))
    shares[free] = np.linalg.norm(vectors[:, values <= _SINGULAR], axis=1)
    return shares


def determine(linearised: Linearised, scales: np.ndarray, names: tuple[str, ...]) -> Determination:
    """Covariance of the shared unknowns from their information, which must be regular."""
    reduced, prior = np.asarray(linearised.reduced), np.asarray(linearised.prior)
    free = np.flatnonzero(scales)
    covariance = np.zeros_like(reduced)
    if len(free) == 0:
        return Determination(covariance, 1.0, (), 0.0)
    information = reduced[np.ix_(free, free)]
    size = np.sqrt(np.diag(information))
    eigenvalues, axes = np.linalg.eigh(information / np.outer(size, size))
    # As the product of a matrix and its transpose it is symmetric to the last digit, however weak a direction is.
    half = axes / np.sqrt(eigenvalues) / size[:, None]
    inverse = half @ half.T
    covariance[np.ix_(free, free)] = inverse * np.outer(scales[free], scales[free])
    # Shares of the prior in the information: generalised eigenvalues, 0 (data only) ... 1. Modes of the board
    # are nuisances: of those the priors may know most.
    told = np.array([not is_mode(names[index]) for index in free])
    free, inverse = free[told], inverse[np.ix_(told, told)]
    root = np.linalg.cholesky(inverse)
    shares, vectors = np.linalg.eigh(root.T @ prior[np.ix_(free, free)] @ root)
    sigma = np.sqrt(np.diag(inverse))
    spectrum = []
    for share, vector in zip(shares[::-1], vectors.T[::-1], strict=True):
        if share > _LEAST_SHARE:
            parts = _components((root @ vector) / sigma, free, names)
            spectrum.append((float(np.sqrt(min(share, 1.0))), parts))
    condition = float(eigenvalues[-1] / eigenvalues[0])
    return Determination(covariance, condition, tuple(spectrum), float(shares[-1]))


def _components(direction: np.ndarray, free: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    largest = np.argsort(-np.abs(direction))[:3]
    return {names[free[i]]: round(float(direction[i]), 3) for i in largest if abs(direction[i]) > 0.1}
