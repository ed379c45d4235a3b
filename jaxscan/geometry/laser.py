"""The laser sheet: a plane, slightly bowed, in the frame of the camera at angle 0."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry.arrays import Array, ArrayModule, Component, namespace, real
from jaxscan.geometry.parameters import ParameterBlock
from jaxscan.geometry.rigid import move_direction, tangent_basis, unit_vector


class LaserSheet(ArrayModule):
    r"""Points $p$ with $n \cdot p = d + \rho\,(b_2 \tau^2 + b_3 \tau^3)$.

    $\rho = \mathrm{hypot}(g \cdot p, e \cdot p)$ and $\tau = \mathrm{atan2}(e \cdot p, g \cdot p)$,
    where $g$ is the optical axis projected into the sheet and $e = n \times g$. The bow is
    homogeneous in $p$, so the intersection with a ray keeps its closed form. With `bow` zero this
    is the plane of the paper.
    """

    normal: Float[Array, "*lasers 3"] = eqx.field(converter=real)
    """Unit normal n, camera frame."""
    distance: Float[Array, "*lasers"] = eqx.field(converter=real)
    """Distance d > 0 of the camera centre from the plane [m]."""
    bow: Float[Array, "*lasers 2"] = eqx.field(converter=real)
    """b2, b3 [rad per rad^2, rad per rad^3]."""
    basis: Float[Array, "*lasers 2 3"] = eqx.field(converter=real)
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
        return namespace(self).stack([self.normal[0], self.normal[1], self.distance]) / self.normal[2]

    def intersect(self, ray: Float[Array, "... 3"]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        r"""Intersection of unit rays and the sheet, or each ray's own sheet.

        $$\text{range} = d / m, \qquad m = n \cdot v - \rho_v (b_2 \tau^2 + b_3 \tau^3)$$

        Returns:
            range_m: Distance along the ray [m]; 0, never NaN, where the ray misses the sheet.
            incidence: m, about the sine of the angle between ray and sheet; the ray meets the
                sheet in front of the camera where it is positive.
        """
        xp = namespace(self, ray)
        incidence = xp.asarray(_dot(self.normal, ray) - self._bow_height(xp, ray))
        hits = incidence > 0
        # 1 where the result is masked, so that neither value nor gradient is NaN.
        range_m = self.distance / xp.where(hits, incidence, 1.0).astype(incidence.dtype)
        return xp.where(hits, range_m, 0.0).astype(range_m.dtype), incidence

    def offset(self, p: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Signed distance of points from the sheet [m], positive on the side of the normal."""
        xp = namespace(self, p)
        return xp.asarray(_dot(self.normal, p) - self.distance - self._bow_height(xp, p))

    def slope(self, p: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
        """Derivative of `offset` by the point [1]: the normal of the bowed sheet there, except for its length."""
        xp = namespace(self, p)
        g, e, along, across, squared = self._in_sheet(xp, p)
        tau, (b2, b3) = xp.arctan2(across, along), (self.bow[..., k] for k in range(2))
        per_rho = 1.0 / xp.sqrt(squared)
        height, rise = tau * tau * (b2 + b3 * tau), tau * (2.0 * b2 + 3.0 * b3 * tau)
        by_along, by_across = per_rho * (along * height - across * rise), per_rho * (across * height + along * rise)
        n = self.normal
        return xp.stack([n[..., k] - by_along * g[k] - by_across * e[k] for k in range(3)], -1)

    def retract(self, step: Float[Array, "*lasers 5"]) -> "LaserSheet":
        """The sheet moved by n1, n2 [rad], d [m], b2, b3; or stacked sheets, each by its own step."""
        normal, basis = move_direction(self.normal, self.basis, step[..., :2])
        return LaserSheet(normal, self.distance + step[..., 2], self.bow + step[..., 3:5], basis)

    def _bow_height(self, xp: Any, p: Array) -> Component:
        _, _, along, across, squared = self._in_sheet(xp, p)
        tau = xp.arctan2(across, along)
        return xp.sqrt(squared) * tau * tau * (self.bow[..., 0] + self.bow[..., 1] * tau)

    def _in_sheet(self, xp: Any, p: Array) -> tuple[Any, Any, Component, Component, Component]:
        """The directions g and e, by component, the coordinates of points along them, and the square of rho."""
        nx, ny, nz = (self.normal[..., k] for k in range(3))
        gx, gy, gz = -nz * nx, -nz * ny, 1.0 - nz * nz
        length = xp.sqrt(gx * gx + gy * gy + gz * gz)
        gx, gy, gz = gx / length, gy / length, gz / length
        e = ny * gz - nz * gy, nz * gx - nx * gz, nx * gy - ny * gx
        x, y, z = (p[..., k] for k in range(3))
        along, across = gx * x + gy * y + gz * z, e[0] * x + e[1] * y + e[2] * z
        squared = along * along + across * across
        # In the middle of the camera the bow is 0, and its derivatives are not NaN.
        there = squared > 0
        along, squared = (xp.where(there, value, 1.0).astype(squared.dtype) for value in (along, squared))
        return (gx, gy, gz), e, along, across, squared


def _dot(a: Array, b: Array) -> Component:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


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
