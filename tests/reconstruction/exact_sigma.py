"""The exact standard deviation of a range: every minimal coordinate of the calibration moved at once."""

import jax
import jax.numpy as jnp


def range_sigma(scanner, q, laser):
    """Standard deviation [m] of the range at pixel `q` [px] from `scanner.covariance`, in float64."""
    with jax.enable_x64(True):
        bare = scanner.as_dtype(jnp.float64)
        return _sigma(bare, jnp.asarray(scanner.covariance), jnp.asarray(q), laser)


@jax.jit
def _sigma(scanner, covariance, q, laser):
    def range_at(step):
        moved = scanner.retract(step)
        return moved.laser(laser).intersect(moved.camera.unproject(q))[0]

    gradient = jax.jacfwd(range_at)(jnp.zeros(len(scanner.parameter_names()), covariance.dtype))
    return jnp.sqrt(gradient @ covariance @ gradient)
