"""The double sphere camera: a lens of two coefficients that sees beyond 180 degrees, inverted in closed form."""

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, Component, namespace
from jaxscan.geometry.cameras.camera import AbstractCamera
from jaxscan.geometry.parameters import ParameterBlock


# Trial values of xi for first values. Two lenses on either side of `_BETWEEN` may differ by only a hundredth of a
# pixel, so the solve tries both. Larger first values than 0.5 lead the solve to lenses with xi above 1.
_XI = np.linspace(-0.6, 0.5, 111)
_BETWEEN = 0.05


class DoubleSphere(AbstractCamera):
    r"""A point is projected onto two unit spheres, one after the other, and then onto the image.

    With $d_1 = |(X, Y, Z)|$, $d_2 = |(X, Y, \xi d_1 + Z)|$ and

    $$D = \alpha d_2 + (1 - \alpha)(\xi d_1 + Z)$$

    the pixel is $u = f_x X / D + c_x$, $v = f_y Y / D + c_y$. On the axis one radian is
    $f / (1 + \xi)$ pixels. With $\xi = 0$ this is the unified camera model, with $\alpha = 0$
    besides the pinhole without distortion.

    Source: Usenko, Demmel and Cremers, The Double Sphere Camera Model (2018), equations (40)-(52).
    """

    model: ClassVar[str] = "double_sphere"
    lens: ClassVar[tuple[ParameterBlock, ...]] = (
        ParameterBlock("sphere", ("xi",), 0.1, prior="xi", sigma=1.0),
        ParameterBlock("sphere", ("alpha",), 0.1, prior="alpha", sigma=0.5, expected=0.5),
    )
    wide: ClassVar[bool] = True

    def project(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Pixels of points [px].

        Undefined behind the camera, and beyond the angle at which the image folds back or ends.
        """
        xp = namespace(self, p)
        scale = self._scale(xp, p)[0]
        return xp.stack([self.fx * (p[..., 0] / scale) + self.cx, self.fy * (p[..., 1] / scale) + self.cy], -1)

    def slopes(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2 3"]:
        """Derivatives of `project` by the point [px per length unit]."""
        xp = namespace(self, p)
        scale, by_aside, by_z = self._scale(xp, p)
        x, y = p[..., 0] / scale, p[..., 1] / scale
        u = [1.0 - x * by_aside * p[..., 0], -x * by_aside * p[..., 1], -x * by_z]
        v = [-y * by_aside * p[..., 0], 1.0 - y * by_aside * p[..., 1], -y * by_z]
        rows = [focal * xp.stack(row, -1) for focal, row in ((self.fx, u), (self.fy, v))]
        return xp.stack(rows, -2) / scale[..., None, None]

    def _scale(self, xp: Any, p: Array) -> tuple[Any, Component, Component]:
        """D; its derivative by X over X, which is that by Y over Y; and its derivative by Z."""
        xi, alpha = self.distortion[0], self.distortion[1]
        aside = p[..., 0] * p[..., 0] + p[..., 1] * p[..., 1]
        d1 = _root(xp, aside + p[..., 2] * p[..., 2])
        z = xi * d1 + p[..., 2]
        d2 = _root(xp, aside + z * z)
        scale = alpha * d2 + (1.0 - alpha) * z
        d1, d2 = (xp.where(d > 0, d, 1.0).astype(d.dtype) for d in (d1, d2))
        along = alpha * z / d2 + 1.0 - alpha
        # 1 where the projection is undefined, so that neither value nor gradient is NaN there.
        scale = xp.where(scale > 0, scale, 1.0).astype(scale.dtype)
        return scale, along * xi / d1 + alpha / d2, along * (xi * p[..., 2] / d1 + 1.0)

    def unproject(self, q: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Unit rays of pixels, in closed form.

        Pixels outside the image of the lens get the ray of the largest angle on their side.
        """
        xp = namespace(self, q)
        xi, alpha = self.distortion[0], self.distortion[1]
        x, y = (q[..., 0] - self.cx) / self.fx, (q[..., 1] - self.cy) / self.fy
        square = x * x + y * y
        inside = 1.0 - (2.0 * alpha - 1.0) * square
        beyond = inside <= 0
        inwards = xp.where(beyond, _root(xp, 1.0 - inside), 1.0).astype(square.dtype)
        x, y = x / inwards, y / inwards
        square = x * x + y * y
        root = xp.where(beyond, 0.0, _root(xp, inside)).astype(square.dtype)
        z = (1.0 - alpha * alpha * square) / (alpha * root + 1.0 - alpha)
        scale = (z * xi + _root(xp, z * z + (1.0 - xi * xi) * square)) / (z * z + square)
        x, y, z = scale * x, scale * y, scale * z - xi
        # Unit but for rounding.
        length = xp.sqrt(x * x + y * y + z * z)
        return xp.stack([x / length, y / length, z / length], -1)

    @staticmethod
    def fit_curve(
        theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "lenses values"]:
        # radius (alpha d2 + (1 - alpha)(xi + cos theta)) = f sin theta is linear in f and alpha.
        trials = []
        for xi in _XI:
            z = xi + np.cos(theta)
            rise = np.hypot(np.sin(theta), z) - z
            alpha = np.linalg.lstsq(np.column_stack([np.sin(theta), -radius * rise]), radius * z, rcond=None)[0][1]
            alpha = np.clip(alpha, 0.05, 0.95)
            curve = np.sin(theta) / (alpha * rise + z)
            focal = radius @ curve / (curve @ curve)
            trials.append((np.sum((focal * curve - radius) ** 2), focal, xi, alpha))
        sides = [[trial for trial in trials if (trial[2] > _BETWEEN) == above] for above in (False, True)]
        return np.array([min(side)[1:] for side in sides])


def _root(xp: Any, square: Component) -> Component:
    """The square root, and 0 with slope 0 where there is none."""
    positive = square > 0
    root = xp.sqrt(xp.where(positive, square, 1.0).astype(square.dtype))
    return xp.where(positive, root, 0.0).astype(square.dtype)
