"""Stripe points as the turning sheet has them: where they would be at angle 0."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, StripeAxis, stripe_pixel
from jaxscan.geometry.arrays import Array
from jaxscan.geometry.motions.turntable import ANGLE_PARAMETERS


CHUNK = 8_192
DIFFERENCE = 1e-3
"""Step of a difference, as a part of the coordinate's spread."""
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
    whole = np.zeros((1, len(scanner.parameter_names())))
    x, slope = _in_chunks(scanner, stripes, whole)
    return x[0], slope[0]


def parameter_slopes(scanner: Scanner, stripes: Stripes) -> Float[np.ndarray, "points 3 params"]:
    """Derivatives of `sheet_points` by the coordinates of camera, sheets and axis [m per px, rad, m]."""
    spread = parameter_spread(scanner)
    steps = np.zeros((len(spread) + 1, len(scanner.parameter_names())))
    steps[1:, : len(spread)] = np.diag(DIFFERENCE * spread)
    x, _ = _in_chunks(scanner, stripes, steps)
    return np.moveaxis(x[1:] - x[0], 0, -1) / (DIFFERENCE * spread)


def _in_chunks(
    scanner: Scanner, stripes: Stripes, steps: Float[np.ndarray, "steps coordinates"]
) -> tuple[Float[np.ndarray, "steps points 3"], Float[np.ndarray, "steps points 3"]]:
    """Points and their derivatives for the scanner moved by each step."""
    columns = (stripes.centre.astype(np.float64), stripes.line.astype(np.int64), stripes.laser.astype(np.int64))
    count = len(stripes.centre)
    x, slope = np.empty((len(steps), count, 3)), np.empty((len(steps), count, 3))
    with jax.enable_x64(True):
        bare = scanner.without_covariance().as_dtype(jnp.float64)
        moves = [jnp.asarray(step) for step in steps]
        for start in range(0, count, CHUNK):
            part = slice(start, min(start + CHUNK, count))
            # Every chunk has one size, so that it is compiled once.
            padded = [jnp.asarray(np.resize(column[part], CHUNK)) for column in columns]
            for k, step in enumerate(moves):
                found = _points(bare, step, *padded, stripes.axis)
                x[k, part], slope[k, part] = (np.asarray(one)[: part.stop - start] for one in found)
    return x, slope


def move(scanner: Scanner, step: Float[np.ndarray, " params"]) -> Scanner:
    """The scanner moved by `step` in the coordinates of camera, sheets and axis [px, rad, m]."""
    with jax.enable_x64(True):
        moved = scanner.retract(jnp.asarray(np.append(step, np.zeros(len(ANGLE_PARAMETERS)))))
        return jax.tree.map(np.asarray, moved)


def parameter_spread(scanner: Scanner) -> Float[np.ndarray, " params"]:
    """How far the coordinates of `parameter_slopes` may be from the truth, generously [px, rad, m]."""
    names = scanner.parameter_names()[: -len(ANGLE_PARAMETERS)]
    return np.array([SPREAD.get(name, SPREAD.get(name.split(".")[-1], 0.1)) for name in names])


# This option halves the time to compile, and costs no time to run.
@functools.partial(jax.jit, static_argnums=5, compiler_options={"xla_cpu_use_fusion_emitters": False})
def _points(scanner, step, centre, line, laser, axis):
    moved = scanner.retract(step)

    def one(c: Array, row: Array, k: Array) -> tuple[Array, Array]:
        def point(across: Array) -> Array:
            return moved.point(stripe_pixel(across, row.astype(across.dtype), axis), k, jnp.zeros_like(across))[0]

        return jax.jvp(point, (c,), (jnp.ones_like(c),))

    return jax.vmap(one)(centre, line, laser)
