"""Rigid motions as 4 x 4 matrices: `T_ab` maps coordinates of frame b to frame a.

Exponentials come from jaxlie; chains of known motions are plain matrix products.
"""

import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry.arrays import Array


def exponential(twist: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """The motion exp(twist) of a twist (v, omega) [m, rad], in jaxlie's order."""
    # Imported here, so that `import jaxscan` does not load jaxlie.
    import jaxlie

    return jaxlie.SE3.exp(jnp.asarray(twist)).as_matrix()


def rigid(rotation: Float[Array, "3 3"], translation: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """The motion p -> rotation p + translation."""
    top = jnp.concatenate([rotation, translation[:, None]], axis=1)
    return jnp.concatenate([top, jnp.zeros((1, 4), top.dtype).at[0, 3].set(1.0)], axis=0)


def transform(T_ab: Float[Array, "4 4"], p_b: Float[Array, "3"]) -> Float[Array, "3"]:
    """The point `p_b` in frame a."""
    return T_ab[:3, :3] @ p_b + T_ab[:3, 3]


def invert(T_ab: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """T_ba."""
    rotation = T_ab[:3, :3].T
    return rigid(rotation, -rotation @ T_ab[:3, 3])
