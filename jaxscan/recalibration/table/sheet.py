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
SPREAD = {
    "fx": 50.0,
    "fy": 50.0,
    "cx": 50.0,
    "cy": 50.0,
    "k1": 0.1,
    "k2": 0.1,
    "k3": 0.3,
    "p1": 0.01,
    "p2": 0.01,
    "d": 0.01,
}
"""How far a coordinate may be from the truth, generously [px, rad, m]; 0.01 for others."""


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
    scanner: Scanner, stripes: Stripes, step: Float[np.ndarray, " params"] | None = None
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Points of stripes at angle 0 in the scanner frame, and how they move with the centre of the stripe.

    A table turns them about z: the point at angle theta is `Rz(theta) x`.

    Args:
        scanner: Any scanner on a turntable.
        stripes: Centres.
        step: Moves the scanner first, in the coordinates of camera, sheets and axis [px, rad, m].

    Returns:
        x: Points [m].
        slope: Their derivative by the centre [m/px].
    """
    columns = (stripes.centre.astype(np.float64), stripes.line.astype(np.int64), stripes.laser.astype(np.int64))
    count = len(stripes.centre)
    x, slope = np.empty((count, 3)), np.empty((count, 3))
    whole = np.zeros(len(scanner.parameter_names()))
    if step is not None:
        whole[: len(step)] = step
    with jax.enable_x64(True):
        bare = scanner.without_covariance().as_dtype(jnp.float64)
        for start in range(0, count, CHUNK):
            part = slice(start, min(start + CHUNK, count))
            # Every chunk has one size, so that it is compiled once.
            padded = [np.resize(column[part], CHUNK) for column in columns]
            found = _points(bare, whole, *padded, stripes.axis)
            x[part], slope[part] = (np.asarray(one)[: part.stop - start] for one in found)
    return x, slope


def parameter_slopes(
    scanner: Scanner,
    stripes: Stripes,
) -> Float[np.ndarray, "points 3 params"]:
    """Derivatives of `sheet_points` by the coordinates of camera, sheets and axis [m per px, rad, m], by differences."""
    x, _ = sheet_points(scanner, stripes)
    spread = parameter_spread(scanner)
    slopes = np.empty((*x.shape, len(spread)))
    for k, step in enumerate(DIFFERENCE * spread):
        moved, _ = sheet_points(scanner, stripes, step * np.eye(len(spread))[k])
        slopes[..., k] = (moved - x) / step
    return slopes


def move(scanner: Scanner, step: Float[np.ndarray, " params"]) -> Scanner:
    """The scanner moved by `step` in the coordinates of camera, sheets and axis [px, rad, m]."""
    with jax.enable_x64(True):
        moved = scanner.retract(jnp.asarray(np.append(step, np.zeros(len(ANGLE_PARAMETERS)))))
        return jax.tree.map(np.asarray, moved)


def parameter_spread(scanner: Scanner) -> Float[np.ndarray, " params"]:
    """How far the coordinates of `parameter_slopes` may be from the truth, generously [px, rad, m]."""
    names = scanner.parameter_names()[: -len(ANGLE_PARAMETERS)]
    return np.array([SPREAD.get(name.split(".")[-1], 0.01) for name in names])


@functools.partial(jax.jit, static_argnums=5)
def _points(scanner, step, centre, line, laser, axis):  # type: ignore[no-untyped-def]
    moved = scanner.retract(step)

    def one(c: Array, row: Array, k: Array) -> tuple[Array, Array]:
        def point(across: Array) -> Array:
            return moved.point(stripe_pixel(across, row.astype(across.dtype), axis), k, jnp.zeros_like(across))[0]

        return jax.jvp(point, (c,), (jnp.ones_like(c),))

    return jax.vmap(one)(centre, line, laser)
