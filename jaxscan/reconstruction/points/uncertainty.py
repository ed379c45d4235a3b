r"""The uncertainty of the range from the calibration's covariance.

With range $= d / m$ a small change of the calibration moves a point along its ray by

$$\delta\,\mathrm{range} = \frac{m\,\delta d - d\,\delta m}{m^2}.$$

The denominator spans orders of magnitude over the image; the standard deviation of the numerator
is smooth. It is therefore evaluated once, exactly and in float64, on a coarse lattice of pixels,
and interpolated.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.compiling import compile_quickly
from jaxscan.geometry import Array, Scanner, StripeAxis, across_and_along, stripe_pixel


SPACING_PX = 16.0
"""Largest distance of two lattice points along a line [px]. With 16 px the interpolated value is
within 0.1 % of the exact one at the test's strong lens (k1 = -0.25)."""


class RangeTable(eqx.Module):
    """std(m dd - d dm) per laser and line on knots across the line."""

    numerator: Float[Array, "lasers lines knots"]
    """[m]"""
    spacing: Float[Array, ""]
    """Distance of two knots [px]."""

    def sigma(
        self, laser: int | Array, line: int | Array, u: Float[Array, ""], incidence: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Standard deviation of the range [m] of one stripe centre; 0 where it misses the sheet."""
        knots = self.numerator.shape[2]
        position = jnp.clip(u / self.spacing, 0.0, knots - 1.0).astype(u.dtype)
        left = jnp.minimum(position.astype(jnp.int32), knots - 2)
        weight = position - left.astype(u.dtype)
        numerator = (1.0 - weight) * self.numerator[laser, line, left]
        numerator += weight * self.numerator[laser, line, left + 1]
        square = incidence * incidence
        hits = incidence > 0
        return jnp.where(hits, numerator / jnp.where(hits, square, 1.0), 0.0).astype(u.dtype)


def range_table(scanner: Scanner, stripe_axis: StripeAxis = "rows") -> RangeTable:
    """Tabulate the effect of `scanner.covariance` on the range, in float64.

    Zero everywhere where the scanner has no covariance.
    """
    across, lines = across_and_along(scanner.camera.width, scanner.camera.height, stripe_axis)
    knots = _knots(across)
    if scanner.covariance is None:
        return RangeTable(np.zeros((len(scanner.laser_names), lines, 2)), np.asarray(float(across - 1)))
    coarse = _knots(lines)
    with jax.enable_x64(True):
        u, line = jnp.meshgrid(jnp.asarray(knots), jnp.asarray(coarse))
        bare = scanner.without_covariance().as_dtype(jnp.float64)
        table = np.asarray(_numerators(bare, jnp.asarray(scanner.covariance), stripe_pixel(u, line, stripe_axis)))
    # Between lattice lines: linear, once for every line, so that a look-up needs two knots only.
    position = np.arange(lines) / (coarse[1] - coarse[0])
    low = np.minimum(position.astype(int), len(coarse) - 2)
    weight = (position - low)[None, :, None]
    full = (1.0 - weight) * table[:, low] + weight * table[:, low + 1]
    return RangeTable(full, np.asarray(knots[1] - knots[0]))


def _knots(count: int) -> np.ndarray:
    return np.linspace(0.0, count - 1.0, max(2, int(np.ceil((count - 1) / SPACING_PX)) + 1))


@compile_quickly
def _numerators(scanner: Scanner, covariance: Array, q: Array) -> Array:
    """[lasers, lattice rows, lattice columns] of std(m dd - d dm)."""
    zero = jnp.zeros(len(scanner.parameter_names()), covariance.dtype)

    def parts(step, laser, q):
        moved = scanner.retract(step)
        sheet = moved.laser(laser)
        return jnp.stack([jnp.asarray(sheet.distance), sheet.intersect(moved.camera.unproject(q))[1]])

    def numerator(laser, q):
        d, m = parts(zero, laser, q)
        change_d, change_m = jax.jacfwd(parts)(zero, laser, q)
        gradient = m * change_d - d * change_m
        return jnp.sqrt(jnp.maximum(gradient @ covariance @ gradient, 0.0))

    over_lattice = jax.vmap(jax.vmap(numerator, (None, 0)), (None, 0))
    return jax.vmap(over_lattice, (0, None))(jnp.arange(len(scanner.laser_names)), q)
