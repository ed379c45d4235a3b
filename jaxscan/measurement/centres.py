"""Where the camera stood."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.geometry import Array, Scanner


def camera_centres(scanner: Scanner, angle: np.ndarray) -> np.ndarray:
    """Camera centre [n, 3], m, scanner frame, at the table's angles [n], rad from home."""
    with jax.enable_x64(True):
        exact = scanner.without_covariance().as_dtype(jnp.float64)
        return np.asarray(_centres(exact, jnp.asarray(angle, jnp.float64)))


@jax.jit
def _centres(scanner: Scanner, angle: Array) -> Array:
    return jax.vmap(scanner.pose)(angle)[:, :3, 3]
