"""The adjustment's problem as `leastsq` sees it, its solution by one compiled program, and where that ends."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array as JaxArray
from jaxtyping import Bool, Float, Int

from jaxscan.compiling import compile_sooner
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Array, Rig
from jaxscan.leastsq import AbstractProblem, Arrow, Covariance, Linear
from jaxscan.leastsq import Unknowns as Step
from jaxscan.recalibration.adjust.blocks import form_blocks, unknowns_of, whitened
from jaxscan.recalibration.adjust.room import Room, Unknowns, moved_rig, moved_stations
from jaxscan.recalibration.adjust.rows import PointRows, Residuals, Rows, observe, twice


class Adjustment(AbstractProblem):
    """The room with its weights."""

    room: Room

    def linearise(self, y: Unknowns) -> tuple[Residuals, Linear]:
        """Derivatives are formed once per point, by the few unknowns that it meets."""
        room, observed = self.room, observe(y, self.room)
        slopes = (
            whitened(observed.points.rows, room.point_weight),
            whitened(observed.sightings, twice(room.sighting_weight)),
        )
        arrow = form_blocks(room, y, observed.residuals, slopes)
        return observed.residuals, Linear(arrow, (observed.points, observed.sightings))

    def move(self, y: Unknowns, step: Step) -> Unknowns:
        """Unknowns are themselves a step from the stored scanner, and are added to."""
        return jax.tree.map(jnp.add, y, unknowns_of(self.room, step.shared, step.local))


class Linearised(NamedTuple):
    """The problem to first order at a step."""

    points: PointRows
    sightings: Rows
    arrow: Arrow
    """The normal equations."""
    cost: Float[Array, ""]
    """Sum of squared whitened residuals, with those of the prior."""
    rig: Rig
    stations: Float[Array, "stations 4 4"]


class Solution(NamedTuple):
    """The end of a solve."""

    y: Unknowns
    linearised: Linearised
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


@compile_sooner
def _solved(room: Room, y: Unknowns, damping: JaxArray, tolerance: JaxArray, max_steps: JaxArray) -> Solution:
    # Imported by whoever solves: it takes its time.
    from jaxscan.leastsq.solver import minimise

    room, y = jax.tree.map(jnp.asarray, (room, y))
    found = minimise(Adjustment(room), y, damping, tolerance, max_steps)
    points, sightings = found.linear.more
    cost = jnp.asarray(sum(jnp.sum(part**2) for part in found.residuals))
    places = moved_rig(room, found.y.scanner), moved_stations(room, found.y.stations)
    end = Linearised(points, sightings, found.linear.arrow, cost, *places)
    return Solution(found.y, end, found.steps, found.converged)


def solve(room: Room, y: Unknowns, damping: float, tolerance: float, max_steps: int) -> Solution:
    """Minimise the sum of squares of all whitened residuals; call in 64 bit. On the host.

    Args:
        room: With its weights.
        y: Where to begin.
        damping: Of the first step, relative to the diagonal of J'J [1].
        tolerance: Root mean square change of unknowns and of whitened residuals at which to stop [1].
        max_steps: Evaluations at most.

    Raises:
        CalibrationError: If a number is not finite.
    """
    found = _solved(room, y, np.float64(damping), np.float64(tolerance), np.int32(max_steps))
    found = Solution(*jax.tree.map(np.asarray, tuple(found)))
    if not found.steps or not all(np.isfinite(part).all() for part in found.y):
        raise CalibrationError("The adjustment left the range of numbers: the captures contradict each other.")
    return found


def linearise(room: Room, y: Unknowns) -> Linearised:
    """Errors and information at a step; call in 64 bit."""
    return solve(room, y, 1.0, 1.0, 1).linearised


def step_of(room: Room, arrow: Arrow, covariance: Covariance) -> Unknowns:
    """The step of Gauss and Newton, (J'J)^-1 J'r; on the host."""
    return Unknowns(*jax.tree.map(np.asarray, tuple(unknowns_of(room, *covariance.step(arrow)))))
