"""A scanner a step away, for differences of which many are taken."""

import jax
import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner


def moved_scanner(scanner: Scanner, step: Float[np.ndarray, " params"]) -> Scanner:
    """The scanner moved by `step` in its minimal coordinates, with NumPy leaves of 64 bits and no covariance."""
    with jax.enable_x64(True):
        bare = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), scanner.without_covariance())
        return jax.tree.map(np.asarray, _retract(bare, np.asarray(step, np.float64)))


# Operation by operation it would take a hundred times as long.
@jax.jit
def _retract(scanner, step):
    return scanner.retract(step)
