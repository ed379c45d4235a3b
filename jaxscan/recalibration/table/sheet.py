"""Stripe points as the turning sheet has them: where they would be at angle 0."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, StripeAxis, stripe_pixel
from jaxscan.geometry.arrays import Array


CHUNK = 16_384


def sheet_points(
    scanner: Scanner,
    centre: Float[np.ndarray, " points"],
    line: Int[np.ndarray, " points"],
    laser: Int[np.ndarray, " points"],
    axis: StripeAxis,
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Points of stripes at angle 0 in the scanner frame, and how they move with the centre of the stripe.

    A table turns them about z: the point at angle theta is `Rz(theta) x`.

    Args:
        scanner: Any scanner on a turntable.
        centre: Across the line [px].
        line: Number of the line.
        laser: The scanner's sheet.
        axis: Along which pixels the lines run.

    Returns:
        x: Points [m].
        slope: Their derivative by `centre` [m/px].
    """
    x, slope = _in_chunks(_points, scanner, (centre.astype(np.float64), line, laser), axis)
    return x, slope


def parameter_slopes(
    scanner: Scanner,
    centre: Float[np.ndarray, " points"],
    line: Int[np.ndarray, " points"],
    laser: Int[np.ndarray, " points"],
    axis: StripeAxis,
) -> Float[np.ndarray, "points 3 params"]:
    """Derivatives of `sheet_points` by the minimal coordinates of camera, sheets and motion [m per px, rad, m]."""
    (slopes,) = _in_chunks(_slopes, scanner, (centre.astype(np.float64), line, laser), axis)
    return slopes


def _in_chunks(function, scanner, columns, axis):  # type: ignore[no-untyped-def]
    count = len(columns[0])
    found = []
    with jax.enable_x64(True):
        bare = scanner.without_covariance().as_dtype(jnp.float64)
        for start in range(0, max(count, 1), CHUNK):
            part = [column[start : start + CHUNK] for column in columns]
            # Every chunk has one size, so that it is compiled once.
            padded = [np.resize(np.append(column, np.zeros(1, column.dtype)), CHUNK) if len(column) < CHUNK else column for column in part]
            found.append([np.asarray(one)[: len(part[0])] for one in function(bare, *padded, axis)])
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


@functools.partial(jax.jit, static_argnums=4)
def _points(scanner, centre, line, laser, axis):  # type: ignore[no-untyped-def]
    def one(c: Array, row: Array, k: Array) -> tuple[Array, Array]:
        def point(across: Array) -> Array:
            return scanner.point(stripe_pixel(across, row.astype(across.dtype), axis), k, jnp.zeros_like(across))[0]

        return jax.jvp(point, (c,), (jnp.ones_like(c),))

    return jax.vmap(one)(centre, line, laser)


@functools.partial(jax.jit, static_argnums=4)
def _slopes(scanner, centre, line, laser, axis):  # type: ignore[no-untyped-def]
    def one(c: Array, row: Array, k: Array) -> Array:
        q = stripe_pixel(c, row.astype(c.dtype), axis)

        def point(step: Array) -> Array:
            return scanner.retract(step).point(q, k, jnp.zeros_like(c))[0]

        return jax.jacfwd(point)(jnp.zeros(len(scanner.parameter_names()), c.dtype))

    return (jax.vmap(one)(centre, line, laser),)
