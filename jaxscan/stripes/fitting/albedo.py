"""How far an edge of the surface's reflectance moved the centre of the stripe that lies over it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from jaxscan.geometry import Array


CERTAIN = 5.0
"""Standard deviations by which a shift must stand out of the noise of the laser-off frame."""
FLOOR = 2.0
"""Standard deviations of the noise below which a level is not believed."""
_PIXEL = 1.0 / 12.0
"""Addition of a pixel's aperture to the square of a stripe's width [px^2]."""


class DarkWindow(NamedTuple):
    """The laser-off frame in the window of a fit."""

    level: Float[Array, "samples n"]
    """[DN]"""
    x: Float[Array, "samples n"]
    """Coordinates of the samples, evenly spaced and rising [px]."""
    used: Bool[Array, "samples n"]
    """Samples that the fit used."""
    variance: Float[Array, "#samples #n"]
    """Variance of `level` [DN^2]."""


class AlbedoShift(NamedTuple):
    """By how much reflectance moved the fitted centre of each line."""

    shift: Float[Array, " n"]
    """Fitted centre minus the centre of the laser's light [px]; 0 where it is lost in the noise."""
    sigma: Float[Array, " n"]
    """Standard deviation of the predicted shift from the laser-off frame's noise [px]."""


def albedo_shift(
    dark: DarkWindow,
    u: Float[Array, " n"],
    width: Float[Array, " n"],
    *,
    offset: Float[Array, ""] | float = 0.0,
) -> AlbedoShift:
    r"""Displacement of fitted centres by the reflectance of the surface around them.

    Under even ambient light the laser-off frame shows the reflectance $\rho$. The visible stripe
    is $\rho$ times the laser's light, so with the fitted Gaussian $h$ that light is $h / \rho$, and
    its centre is the true one:

    $$\mathrm{shift} = \frac{\sum x\,h}{\sum h} - \frac{\sum x\,h / \rho}{\sum h / \rho}
      \approx w^2 \rho' / \rho .$$

    On a straight slope this is the displacement that a straight line through the laser-off frame
    gives; at printed edges of 5 : 1, where the line gives half of it, it stays within a quarter. A shift
    below 3 standard deviations of the noise is 0, so that a clean surface keeps its sigma.

    Args:
        dark: The laser-off frame in the window of the fit.
        u: Fitted centre, in the coordinates of `dark.x` [px].
        width: Fitted standard deviation of the stripe [px].
        offset: Level of a pixel without light [DN].

    Returns:
        Shift and its standard deviation; for an honest standard deviation of the centre add the square of
        the shift to its square.
    """
    seen = jnp.sqrt(width * width + _PIXEL)
    x, used = dark.x, dark.used
    z = (x - u[None, :]) * (1.0 / seen)[None, :]
    light = jnp.where(used, jnp.exp(-0.5 * z * z), 0.0)
    variance = jnp.broadcast_to(jnp.asarray(dark.variance), z.shape)
    level = jnp.maximum(dark.level - offset, FLOOR * jnp.sqrt(variance))
    per_level = 1.0 / level
    source = light * per_level
    # Of the centre by one sample's level: (z - mean) source / level / sum(source).
    pull = source * per_level
    pull = pull * pull * variance
    (total, first), (plain, plain_first) = moments(source, 2), moments(light, 2)
    pulls, pulls_s, pulls_ss = moments(pull, 3)
    some = total > 0
    total = jnp.where(some, total, 1.0)
    mean = first / total
    square = jnp.maximum(pulls_ss - 2.0 * mean * pulls_s + mean * mean * pulls, 0.0)
    pitch = x[1] - x[0]
    sigma = pitch * jnp.sqrt(square) / total
    shift = pitch * (plain_first / jnp.where(some, plain, 1.0) - mean)
    certain = some & (jnp.abs(shift) > CERTAIN * sigma)
    return AlbedoShift(jnp.where(certain, shift, 0.0), sigma)


def moments(values: Float[Array, "samples n"], count: int) -> Float[Array, "{count} n"]:
    """Sums over the window, times 1, s, s^2, ... with s the sample's number from the middle.

    A product with a fixed matrix, of which a CPU's compiler makes several times more than of as many sums.
    """
    samples = values.shape[0]
    number = np.arange(samples) - 0.5 * (samples - 1)
    powers = jnp.asarray(np.stack([number**power for power in range(count)]), values.dtype)
    return jnp.matmul(powers, values, precision=lax.Precision.HIGHEST)
