"""Unit vectors in minimal coordinates: a direction, and two tangent vectors that steps refer to."""

import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry.arrays import Array


def tangent_basis(direction: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Two orthonormal vectors perpendicular to the unit vector `direction`."""
    # The coordinate axis after the largest component is safe to cross with. The least parallel one
    # would be too, but which of two that is, changes with the last digits of an upright axis.
    helper = jnp.zeros_like(jnp.asarray(direction)).at[(jnp.argmax(jnp.abs(direction)) + 1) % 3].set(1.0)
    first = jnp.cross(direction, helper)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(direction, first)])


def move_direction(
    direction: Float[Array, "3"], basis: Float[Array, "2 3"], step: Float[Array, "2"]
) -> tuple[Float[Array, "3"], Float[Array, "2 3"]]:
    """Move a unit vector by `step` [rad, to first order] along its tangent vectors.

    Returns:
        direction: The moved unit vector.
        basis: The tangent vectors carried along: orthonormal and perpendicular to it again.
    """
    moved = direction + step[0] * basis[0] + step[1] * basis[1]
    moved = moved / jnp.linalg.norm(moved)
    first = basis[0] - jnp.dot(basis[0], moved) * moved
    first = first / jnp.linalg.norm(first)
    second = basis[1] - jnp.dot(basis[1], moved) * moved - jnp.dot(basis[1], first) * first
    return moved, jnp.stack([first, second / jnp.linalg.norm(second)])
