"""Stripe points as the turning sheet has them: where they would be at angle 0."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, StripeAxis, stripe_pixel
from jaxscan.geometry.arrays import Array
from jaxscan.geometry.motions.turntable import ANGLE_PARAMETERS
from jaxscan.recalibration.moved import moved_scanner
from jaxscan.recalibration.observed import SweepStripes


CHUNK = 6_144
SPREAD = (
    {"fx": 20.0, "fy": 20.0, "cx": 20.0, "cy": 20.0, "k1": 0.05, "k2": 0.1, "k3": 0.3, "p1": 2e-3, "p2": 2e-3}
    | {"n1": 3e-3, "n2": 3e-3, "d": 2e-3, "b2": 3e-3, "b3": 3e-3}
    | {"axis.d1": 5e-3, "axis.d2": 5e-3, "axis.p1": 3e-3, "axis.p2": 3e-3}
)
"""How far a coordinate of a poor calibration may be from the truth [px, rad, m]; 0.1 for others."""


class Stripes(NamedTuple):
    """Centres of stripes, in no order."""

    centre: Float[np.ndarray, " points"]
    """Across the line [px]."""
    line: Int[np.ndarray, " points"]
    laser: Int[np.ndarray, " points"]
    """The scanner's sheet."""
    axis: StripeAxis

    def take(self, index: np.ndarray, shift: Float[np.ndarray, " taken"]) -> "Stripes":
        """The stripes at `index`, with centres that are `shift` px further."""
        return Stripes(self.centre[index] + shift, self.line[index], self.laser[index], self.axis)


def sheet_points(
    scanner: Scanner, stripes: Stripes
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Points of stripes at angle 0 in the scanner frame, and how they move with the centre of the stripe.

    A table turns them about z: the point at angle theta is `Rz(theta) x`.

    Returns:
        x: Points [m].
        slope: Their derivative by the centre [m/px].
    """
    x, slope = _in_chunks(_points, scanner, stripes)
    return x, slope


def points_of_records(scanner: Scanner, sweep: SweepStripes) -> Callable[[int], Float[np.ndarray, "points 3"] | None]:
    """`sheet_points` of the first stripe of each record, in the order along it; None for a record without a stripe."""

    def points(record: int) -> Float[np.ndarray, "points 3"] | None:
        profiles = np.flatnonzero(sweep.record == record)
        if not len(profiles):
            return None
        first = int(profiles[0])
        line = np.flatnonzero(sweep.valid[first])
        laser = np.full(len(line), sweep.laser[first])
        return sheet_points(scanner, Stripes(sweep.centre[first, line], line, laser, sweep.stripe_axis))[0]

    return points


def parameter_slopes(scanner: Scanner, stripes: Stripes) -> Float[np.ndarray, "points 3 params"]:
    """Derivatives of `sheet_points` by the coordinates of camera, sheets and axis [m per px, rad, m]."""
    (slopes,) = _in_chunks(_slopes, scanner, stripes)
    return slopes


def _in_chunks(function: Callable, scanner: Scanner, stripes: Stripes) -> tuple[np.ndarray, ...]:
    """The results of a compiled function of the scanner and stripes, one after another."""
    columns = (stripes.centre.astype(np.float64), stripes.line.astype(np.int64), stripes.laser.astype(np.int64))
    count, parts = len(stripes.centre), []
    with jax.enable_x64(True):
        bare = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), scanner.without_covariance())
        for start in range(0, max(count, 1), CHUNK):
            part = slice(start, min(start + CHUNK, count))
            # Every chunk has one size, so that it is compiled once.
            padded = [np.resize(column[part], CHUNK) for column in columns]
            parts.append([np.asarray(one)[: part.stop - start] for one in function(bare, *padded, stripes.axis)])
    return tuple(np.concatenate(one) for one in zip(*parts, strict=True))


def move(scanner: Scanner, step: Float[np.ndarray, " params"]) -> Scanner:
    """The scanner moved by `step` in the coordinates of camera, sheets and axis [px, rad, m]."""
    return moved_scanner(scanner, np.append(step, np.zeros(len(ANGLE_PARAMETERS))))


def parameter_spread(scanner: Scanner) -> Float[np.ndarray, " params"]:
    """How far the coordinates of `parameter_slopes` may be from the truth, generously [px, rad, m]."""
    names = scanner.parameter_names()[: -len(ANGLE_PARAMETERS)]
    return np.array([SPREAD.get(name, SPREAD.get(name.split(".")[-1], 0.1)) for name in names])


# This option halves the time to compile, and costs no time to run.
_compiled = functools.partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False})


@functools.partial(_compiled, static_argnums=4)
def _points(scanner, centre, line, laser, axis):
    def one(c: Array, row: Array, k: Array) -> tuple[Array, Array]:
        return jax.jvp(lambda across: _point(scanner, across, row, k, axis), (c,), (jnp.ones_like(c),))

    return jax.vmap(one)(centre, line, laser)


@functools.partial(_compiled, static_argnums=4)
def _slopes(scanner, centre, line, laser, axis):
    first = jnp.zeros(len(scanner.parameter_names()) - len(ANGLE_PARAMETERS))

    def one(c: Array, row: Array, k: Array) -> Array:
        def moved(step: Array) -> Array:
            whole = jnp.append(step, jnp.zeros(len(ANGLE_PARAMETERS)))
            return _point(scanner.retract(whole), c, row, k, axis)

        return jax.jacfwd(moved)(first)

    return (jax.vmap(one)(centre, line, laser),)


def _point(scanner: Scanner, across: Array, row: Array, laser: Array, axis: StripeAxis) -> Array:
    """The point at angle 0 of one stripe [m]."""
    return scanner.point(stripe_pixel(across, row.astype(across.dtype), axis), laser, jnp.zeros_like(across))[0]
