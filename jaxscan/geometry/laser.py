"""The laser sheet: a plane, slightly bowed, in the frame of the camera at angle 0."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry.arrays import Array, real
from jaxscan.geometry.parameters import ParameterBlock
from jaxscan.geometry.tangent import move_direction, tangent_basis, unit_vector


class LaserSheet(eqx.Module):
    r"""Points $p$ with $n \cdot p = d + \rho\,(b_2 \tau^2 + b_3 \tau^3)$.

    $\rho = \mathrm{hypot}(g \cdot p, e \cdot p)$ and $\tau = \mathrm{atan2}(e \cdot p, g \cdot p)$,
    where $g$ is the optical axis projected into the sheet and $e = n \times g$. The bow is
    homogeneous in $p$, so the intersection with a ray keeps its closed form. With `bow` zero this
    is the plane of the paper.
    """

    normal: Float[Array, "3"] = eqx.field(converter=real)
    """Unit normal n, camera frame."""
    distance: Float[Array, ""] = eqx.field(converter=real)
    """Distance d > 0 of the camera centre from the plane [m]."""
    bow: Float[Array, "2"] = eqx.field(converter=real)
    """b2, b3 [rad per rad^2, rad per rad^3]."""
    basis: Float[Array, "2 3"] = eqx.field(converter=real)
    """Tangent vectors of the minimal coordinates n1, n2 of the normal."""

    @staticmethod
    def from_plane(normal: ArrayLike | Sequence[float], distance: ArrayLike) -> "LaserSheet":
        """The flat sheet `normal . p = distance`, camera frame at angle 0.

        Args:
            normal: Three numbers; neither sign nor length matters.
            distance: Distance [m], times the length of the normal.

        Raises:
            ValueError: If the normal is zero, or the plane contains the camera centre.
        """
        n, length = unit_vector(normal, "normal of the plane")
        d = float(np.asarray(distance)) / length
        if not 0 < abs(d) < np.inf:
            raise ValueError(f"distance: found {d:g} m, expected a plane that does not contain the camera centre")
        n = np.copysign(1.0, d) * n
        return LaserSheet(n, np.asarray(abs(d)), np.zeros(2), tangent_basis(n))

    @staticmethod
    def from_abc(a: float, b: float, c: float) -> "LaserSheet":
        """The paper's plane `a X + b Y + Z = c` [c in m]. Source: the paper, equation (4)."""
        return LaserSheet.from_plane(np.array([a, b, 1.0]), c)

    def abc(self) -> Float[Array, "3"]:
        """The paper's a, b [1] and c [m] of the flat part. Source: the paper, equation (4)."""
        return jnp.stack([self.normal[0], self.normal[1], jnp.asarray(self.distance)]) / self.normal[2]

    def intersect(self, ray: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        r"""Intersection of a unit ray and the sheet.

        $$\text{range} = d / m, \qquad m = n \cdot v - \rho_v (b_2 \tau^2 + b_3 \tau^3)$$

        Args:
            ray: Unit ray v, camera frame.

        Returns:
            range_m: Distance along the ray [m]; 0, never NaN, where the ray misses the sheet.
            incidence: m, about the sine of the angle between ray and sheet; the ray meets the
                sheet in front of the camera where it is positive.
        """
        incidence = jnp.dot(self.normal, ray) - self._bow_slope(ray)
        hits = incidence > 0
        # 1 where the result is masked, so that neither value nor gradient is NaN.
        range_m = self.distance / jnp.where(hits, incidence, 1.0).astype(incidence.dtype)
        return jnp.where(hits, range_m, 0.0).astype(range_m.dtype), incidence

    def offset(self, p: Float[Array, "3"]) -> Float[Array, ""]:
        """Signed distance of a point from the sheet [m], positive on the side of the normal."""
        return jnp.dot(self.normal, p) - self.distance - self._bow_slope(p)

    def retract(self, step: Float[Array, "5"]) -> "LaserSheet":
        """The sheet moved by n1, n2 [rad], d [m], b2, b3."""
        normal, basis = move_direction(self.normal, self.basis, step[:2])
        return LaserSheet(normal, self.distance + step[2], self.bow + step[3:5], basis)

    def _bow_slope(self, p: Float[Array, "3"]) -> Float[Array, ""]:
        g = jnp.zeros_like(self.normal).at[2].set(1.0) - self.normal[2] * self.normal
        g = g / jnp.linalg.norm(g)
        along, across = jnp.dot(g, p), jnp.dot(jnp.cross(self.normal, g), p)
        squared = along * along + across * across
        safe = jnp.where(squared > 0, squared, 1.0).astype(squared.dtype)
        tau = jnp.arctan2(across, jnp.where(squared > 0, along, 1.0).astype(along.dtype))
        return jnp.sqrt(safe) * tau * tau * (self.bow[0] + self.bow[1] * tau)


LASER_BLOCKS = (
    ParameterBlock("laser", ("n1", "n2", "d"), 0.01, "rad, m"),
    ParameterBlock("bow", ("b2", "b3"), 0.001, "rad / rad^2, rad / rad^3", prior="bow", sigma=1e-2),
)
"""Minimal coordinates of a sheet, in the order of `LaserSheet.retract`."""


def stack_lasers(lasers: list[LaserSheet]) -> LaserSheet:
    """Several sheets, or none, as one pytree, every leaf with a leading axis over lasers."""
    if not lasers:
        return jax.tree.map(lambda leaf: leaf[:0], stack_lasers([LaserSheet.from_plane([1.0, 0.0, 0.0], 1.0)]))
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *lasers)
