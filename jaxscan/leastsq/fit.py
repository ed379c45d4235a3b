r"""A fit of residuals that anybody may write, with robust losses and a prior.

$$\min_{x, b} \; \sum_g \sum_i \rho_g(r_{g,i}(x, b_i) / \sigma_{g,i}) + \tfrac12 (x - \bar x)^T \Lambda (x - \bar x)$$
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array as JaxArray
from jaxtyping import Float, Int

from jaxscan.compiling import compile_sooner
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array
from jaxscan.leastsq.arrow import (
    AbstractProblem,
    Arrow,
    Covariance,
    Linear,
    Normal,
    Unknowns,
    covariance_of,
    sum_arrow,
    undetermined,
)
from jaxscan.leastsq.robust import Loss, noise_component


# Damping of the first step, relative to J'J.
_DAMPING = 1e-4


class Group(eqx.Module):
    """Residuals of one kind: those of every owner follow from the shared unknowns, the owner's block, and its data."""

    residual: Callable[[Any, Any, Any], Any] = eqx.field(static=True)
    """`residual(shared, own, data)` of one owner, in `jax.numpy`: a number or an array. `own` is its block, None in a
    group without blocks. A function of a module is compiled once, one that is made anew at each call each time."""
    data: Any
    """A tree of arrays that lead with the axis of the owners."""
    sigma: Any = 1.0
    """Standard deviations, in the residuals' unit: one for all, or one for each owner."""
    block: Any = None
    """The number of each owner's block; None where it has none."""
    loss: Loss | None = eqx.field(static=True, default=None)
    """A robust loss, as `Huber()`; None: the square."""

    @property
    def owners(self) -> int:
        """How many owners there are."""
        return len(jax.tree.leaves(self.data)[0])


class Prior(NamedTuple):
    """What is known of the shared unknowns beforehand: they are normal about a mean."""

    mean: Any
    """A tree like the shared unknowns."""
    information: Float[Array, "shared shared"]
    """The inverse of the covariance, in the order of the tree's leaves; 0 for numbers of which nothing is known."""


class _Problem(AbstractProblem):
    """Shared unknowns as one vector; points are added to."""

    groups: tuple[Group, ...]
    mean: Float[Array, " shared"]
    information: Float[Array, "shared shared"]
    tree: Any
    """Shared unknowns as they were given, for their shapes."""

    def linearise(self, y: Unknowns) -> tuple[Any, Linear]:
        """Derivatives by forward mode, of each owner by what it meets."""
        count, (blocks, own) = len(y.shared), y.local.shape
        residuals, slopes, parts = [], [], []
        for group in self.groups:
            value, by = self._rows(group, y)
            upright = jnp.swapaxes(by, 1, 2)
            parts.append(Normal(upright @ by, (upright @ value[..., None])[..., 0], group.block))
            residuals.append(value)
            slopes.append(by)
        away = y.shared - self.mean
        parts.append(Normal(self.information[None], (self.information @ away)[None]))
        # The prior has no residuals of its own, but its part of the cost.
        prior = jnp.sqrt(jnp.maximum(away @ self.information @ away, 0.0))
        return (tuple(residuals), prior), Linear(sum_arrow(parts, count, (blocks, own)), tuple(slopes))

    def move(self, y: Unknowns, step: Unknowns) -> Unknowns:
        """Point and step are vectors."""
        return jax.tree.map(jnp.add, y, step)

    def _rows(self, group: Group, y: Unknowns) -> tuple[Float[Array, "owners rows"], Float[Array, "owners rows all"]]:
        """Whitened residuals of a group, and their derivatives by the shared unknowns and the block."""
        count, shaped = len(y.shared), ravel_pytree(self.tree)[1]
        own = jnp.zeros((group.owners, 0), y.shared.dtype) if group.block is None else y.local[group.block]

        def one(own, data, sigma):
            def rows(numbers):
                block = None if group.block is None else numbers[count:]
                value = jnp.ravel(group.residual(shaped(numbers[:count]), block, data)) / sigma
                value = value if group.loss is None else group.loss.root(value)
                return value, value

            slopes, value = jax.jacfwd(rows, has_aux=True)(jnp.concatenate([y.shared, own]))
            return value, slopes

        return jax.vmap(one)(own, group.data, jnp.broadcast_to(group.sigma, (group.owners,)))


@dataclass(frozen=True)
class Fit:
    """The end of a fit; NumPy."""

    shared: Any
    """The shared unknowns, a tree as it was given."""
    blocks: Float[np.ndarray, "blocks own"]
    residuals: tuple[Float[np.ndarray, "_owners _rows"], ...]
    """Residuals of each group, in standard deviations; with a robust loss its root (`Loss.root`)."""
    slopes: tuple[Float[np.ndarray, "_owners _rows _unknowns"], ...]
    """Their derivatives by the shared unknowns and the block of the owner."""
    block: tuple[Int[np.ndarray, " _owners"] | None, ...]
    """The block of each owner, of each group."""
    arrow: Arrow
    """The normal equations."""
    steps: int
    """Points at which residuals were evaluated."""
    converged: bool
    """False where it stopped after its last step: the numbers then mean nothing."""

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of all unknowns; shared ones in the order of the tree's leaves.

        Raises:
            CalibrationError: If the residuals leave a combination of unknowns undetermined.
        """
        every = np.arange(len(self.arrow.shared))
        if not len(every) or not undetermined(self.arrow, every).any():
            return covariance_of(self.arrow)
        raise CalibrationError(
            "The residuals leave a combination of the shared unknowns undetermined: add observations, or a prior."
        )

    @cached_property
    def leverages(self) -> tuple[Float[np.ndarray, "_owners _rows"], ...]:
        """Share of each residual that the fit takes up [1], of each group: 0 ... 1.

        Raises:
            CalibrationError: As `covariance`.
        """
        every = []
        for slopes, block in zip(self.slopes, self.block, strict=True):
            known = self.covariance.shared if block is None else self.covariance.of(block)
            every.append(np.sum((slopes @ known) * slopes, axis=-1))
        return tuple(every)

    @property
    def noise(self) -> tuple[float, ...]:
        """Standard deviation of each group over the given ones, per degree of freedom [1]."""
        pairs = zip(self.residuals, self.leverages, strict=True)
        return tuple(noise_component(residuals.ravel(), leverage.ravel()) for residuals, leverage in pairs)


def fit(
    shared: Any,
    groups: Sequence[Group],
    *,
    blocks: Float[Array, "blocks own"] | None = None,
    prior: Prior | None = None,
    tolerance: float = 1e-8,
    max_steps: int = 100,
) -> Fit:
    """Fit shared unknowns and blocks to groups of residuals, in float64 whatever the caller's JAX settings.

    Unknowns should be scaled so that a change by 1 matters about as much in each: the damping follows their scales by
    itself, the tolerance does not.

    Args:
        shared: First values of the shared unknowns, a tree of arrays.
        groups: The residuals.
        blocks: First values of the blocks.
        prior: What is known of the shared unknowns beforehand.
        tolerance: Root mean square change of unknowns and of whitened residuals at which to stop.
        max_steps: Evaluations at most.

    Raises:
        CalibrationError: If residuals are not finite where the fit begins.
    """
    with jax.enable_x64(True):
        double = lambda leaf: np.asarray(leaf, np.float64)
        tree = jax.tree.map(double, shared)
        flat, shaped = ravel_pytree(tree)
        local = np.zeros((0, 0)) if blocks is None else double(blocks)
        mean, information = np.zeros(len(flat)), np.zeros((len(flat), len(flat)))
        if prior is not None:
            mean = np.asarray(ravel_pytree(jax.tree.map(double, prior.mean))[0])
            information = double(prior.information)
        problem = _Problem(tuple(groups), mean, information, tree)
        start = Unknowns(np.asarray(flat), local)
        found = minimised(problem, start, _DAMPING, tolerance, max_steps)
        residuals, _ = found.residuals
        # Nothing is evaluated where the first values are no numbers.
        if found.steps == 0 or not all(np.isfinite(part).all() for part in residuals):
            raise CalibrationError("Residuals are not finite where the fit begins: check the first values.")
        index = lambda block: None if block is None else np.asarray(block)
        return Fit(
            jax.tree.map(np.asarray, shaped(found.y.shared)),
            found.y.local,
            residuals,
            found.linear.more,
            tuple(index(group.block) for group in groups),
            found.linear.arrow,
            int(found.steps),
            bool(found.converged),
        )


def minimised(problem: AbstractProblem, y: Any, damping: float, tolerance: float, max_steps: int) -> Any:
    """The end of a solve, `solver.Minimum`, in NumPy; call in 64 bit.

    One program is compiled for all problems of one class and of one size.

    Args:
        problem: The problem.
        y: Where to begin.
        damping: Damping of the first step, relative to the diagonal of J'J [1].
        tolerance: Root mean square change of unknowns and of whitened residuals at which to stop [1].
        max_steps: Evaluations at most; 1 gives the residuals and normal equations of `y` itself.
    """
    found = _minimised(problem, y, np.float64(damping), np.float64(tolerance), np.int32(max_steps))
    return jax.tree.map(np.asarray, found)


@compile_sooner
def _minimised(problem: AbstractProblem, y: Any, damping: JaxArray, tolerance: JaxArray, max_steps: JaxArray) -> Any:
    # Imported by whoever solves: it takes its time.
    from jaxscan.leastsq.solver import minimise

    problem, y = jax.tree.map(jnp.asarray, (problem, y))
    return minimise(problem, y, damping, tolerance, max_steps)
