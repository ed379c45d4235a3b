"""The least-squares solve: optimistix' loop and trust region round the block elimination."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array, Rig
from jaxscan.recalibration.adjust.blocks import (
    Blocks,
    columns,
    form_blocks,
    solve_blocks,
    unknowns_of,
    whitened,
    zero_blocks,
)
from jaxscan.recalibration.adjust.room import Room, Unknowns, moved_rig, moved_stations
from jaxscan.recalibration.adjust.rows import PointRows, Rows, observe, residuals, twice


# Dense unknowns from which the time of an inverse counts.
_MANY = 500
# Relative rounding error of a sum of some ten thousand squares.
_ROUNDING = 1e-13


class PatientTrustRegion(optx.AbstractSearch):
    """optimistix' trust region, which takes a cost that changed by rounding alone for no worse.

    Beside the minimum the last steps change the cost by less than its last digit; judged by that
    digit every other one would be refused, thirty times in a row.
    """

    inner: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion()

    def init(self, y: Any, f_info_struct: Any) -> Any:
        return self.inner.init(y, f_info_struct)

    def step(self, first_step: Any, y: Any, y_eval: Any, f_info: Any, f_eval_info: Any, state: Any) -> Any:
        size, accept, result, new_state = self.inner.step(first_step, y, y_eval, f_info, f_eval_info, state)
        cost, new_cost = f_info.as_min(), f_eval_info.as_min()
        same = jnp.abs(new_cost - cost) <= _ROUNDING * cost
        size = jnp.where(same, jnp.maximum(size, state.step_size), size)
        return size, accept | same, result, eqx.tree_at(lambda s: s.step_size, new_state, size)


class BlockArrowLM(optx.AbstractGaussNewton):
    """optimistix' Gauss-Newton loop and trust region round the descent of a problem."""

    rtol: Any
    atol: Any
    descent: Any  # type: ignore[misc]
    norm: Any = optx.rms_norm
    search: Any = PatientTrustRegion()
    verbose: Any = eqx.field(default=lambda **_: None, static=True)


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
        return y, form_blocks(self.room, y, f_info.residual, columns(f_info.jac.mv, y))

    def step(self, step_size: Any, state: tuple[Unknowns, Blocks]) -> tuple[Unknowns, Any]:
        step = solve_blocks(self.room, *state, self.damping / step_size)
        return jax.tree.map(jnp.negative, step), optx.RESULTS.successful


def _solve(room: Room, y: Unknowns, limits: tuple[Array, Array], max_steps: int) -> Solution:
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

    points: PointRows
    sightings: Rows
    blocks: Blocks
    cost: Float[Array, ""]
    """Sum of squared whitened residuals, with those of the prior."""
    rig: Rig
    stations: Float[Array, "stations 4 4"]


def _linearise(room: Room, y: Unknowns) -> Linearised:
    """Errors and information at a step; call in 64 bit."""
    observed = observe(y, room)
    slopes = (
        whitened(observed.points.rows, room.point_weight),
        whitened(observed.sightings, twice(room.sighting_weight)),
    )
    blocks = form_blocks(room, y, observed.residuals, slopes)
    cost = sum(jnp.sum(part**2) for part in observed.residuals)
    return Linearised(
        observed.points,
        observed.sightings,
        blocks,
        jnp.asarray(cost),
        moved_rig(room, y.scanner),
        moved_stations(room, y.stations),
    )


class Covariance(NamedTuple):
    """Of the unknowns at the minimum, in their units."""

    information: Float[np.ndarray, "dense dense"]
    """Of the dense unknowns, with all others free."""
    dense: Float[np.ndarray, "dense dense"]
    coupling: Float[np.ndarray, "locals 3 dense"]
    """How surfaces and tracked points follow the dense unknowns, with a minus."""
    local: Float[np.ndarray, "locals 3 3"]
    """Of surfaces and tracked points, if the dense unknowns were known."""


def covariance_of(blocks: Blocks) -> Covariance:
    """The inverse of J'J, by blocks; on the host."""
    empty = np.diagonal(blocks.local, axis1=1, axis2=2) == 0
    local = np.linalg.inv(blocks.local + empty[:, :, None] * np.eye(3))
    coupling = local @ np.swapaxes(blocks.cross, 1, 2)
    count = len(blocks.dense)
    cross = np.swapaxes(blocks.cross, 1, 2).reshape(-1, count)
    information = blocks.dense - cross.T @ coupling.reshape(-1, count)
    # Held unknowns and padding have no information; a 1 keeps the matrix regular.
    information = information + np.diag((np.diag(blocks.dense) == 0).astype(float))
    size = 1.0 / np.sqrt(np.diag(information))
    scaled = information * np.outer(size, size)
    if count > _MANY:
        inverse = np.linalg.inv(scaled) * np.outer(size, size)
        return Covariance(information, (inverse + inverse.T) / 2, coupling, local)
    # As the product of a matrix and its transpose it is symmetric to the last digit, however weak a direction is.
    half = np.linalg.inv(np.linalg.cholesky(scaled)) * size[None, :]
    return Covariance(information, half.T @ half, coupling, local)


def compiled(function: Any, **more: Any) -> Any:
    """The function for arrays of one size, as those are compiled that run some ten times; with further options."""
    # This option halves the time to compile, and costs no time to run.
    options: Any = {"compiler_options": {"xla_cpu_use_fusion_emitters": False, **more}}
    return eqx.filter_jit(function, **options)


solve: Callable[..., Solution] = compiled(_solve)
linearise: Callable[[Room, Unknowns], Linearised] = compiled(_linearise)


def step_of(room: Room, blocks: Blocks, covariance: Covariance) -> Unknowns:
    """The step of Gauss and Newton, (J'J)^-1 J'r; on the host."""
    by_local = np.einsum("lij,lj->li", covariance.local, blocks.local_gradient)
    cross = np.swapaxes(blocks.cross, 1, 2).reshape(-1, len(blocks.dense))
    dense = covariance.dense @ (blocks.dense_gradient - cross.T @ by_local.ravel())
    return unknowns_of(room, dense, by_local - covariance.coupling @ dense)


def on_host(tree: Any) -> Any:
    """The same arrays in NumPy."""
    return jax.tree.map(np.asarray, tree)
