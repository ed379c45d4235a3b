"""The pinhole camera with the distortion of Brown and Conrady."""

from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, Component, namespace, real, solve_by_newton
from jaxscan.geometry.cameras.camera import AbstractCamera
from jaxscan.geometry.parameters import ParameterBlock


class Pinhole(AbstractCamera):
    r"""Pinhole with Brown-Conrady distortion.

    With $x = X/Z$, $y = Y/Z$, $r^2 = x^2 + y^2$ and the radial factor

    $$R = \frac{1 + k_1 r^2 + k_2 r^4 + k_3 r^6}{1 + k_4 r^2 + k_5 r^4 + k_6 r^6}$$

    the pixel is $u = f_x x' + s y' + c_x$, $v = f_y y' + c_y$ with
    $x' = x R + 2 p_1 x y + p_2 (r^2 + 2 x^2)$ and
    $y' = y R + p_1 (r^2 + 2 y^2) + 2 p_2 x y$.

    Source: the paper, equations (1)-(3), which are the special case $k = k_1$; the order of the
    coefficients is OpenCV's.
    """

    model: ClassVar[str] = "pinhole"
    lens: ClassVar[tuple[ParameterBlock, ...]] = (
        ParameterBlock("radial", ("k1", "k2"), 0.1),
        ParameterBlock("tangential", ("p1", "p2"), 0.01, prior="tangential", sigma=2e-3),
        ParameterBlock("k3", ("k3",), 0.1, prior="k3", sigma=1.0),
        ParameterBlock("rational", ("k4", "k5", "k6"), 0.1, prior="k3", sigma=1.0, optional=True),
    )
    wide: ClassVar[bool] = False

    skew: Float[Array, ""] = eqx.field(default=0.0, converter=real)
    """Skew s of the pixel axes [px]; known, never estimated."""

    def project(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Pixels of points [px].

        Continuous but meaningless for points on or behind the camera plane.
        """
        xp = namespace(self, p)
        x, y, _ = _plane(xp, p)
        x, y = _distort(x, y, self.distortion)
        return xp.stack([self.fx * x + self.skew * y + self.cx, self.fy * y + self.cy], -1)

    def slopes(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2 3"]:
        """Derivatives of `project` by the point [px per length unit]."""
        xp = namespace(self, p)
        x, y, z = _plane(xp, p)
        xx, xy, yy = _distort_slopes(x, y, self.distortion)
        rows = (self.fx * xx + self.skew * xy, self.fx * xy + self.skew * yy), (self.fy * xy, self.fy * yy)
        return xp.stack([xp.stack([a / z, b / z, -(a * x + b * y) / z], -1) for a, b in rows], -2)

    def unproject(self, q: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Unit rays of pixels, by Newton's method: 1e-10 px in float64, 1e-3 px in float32."""
        xp = namespace(self, q)
        y = (q[..., 1] - self.cy) / self.fy
        x = (q[..., 0] - self.cx - self.skew * y) / self.fx

        def newton(point, parameters):
            (x, y), (target_x, target_y, k) = point, parameters
            distorted_x, distorted_y = _distort(x, y, k)
            a, b, d = _distort_slopes(x, y, k)
            error_x, error_y = distorted_x - target_x, distorted_y - target_y
            det = a * d - b * b
            det = xp.where(det == 0, 1.0, det).astype(det.dtype)
            step_x, step_y = (d * error_x - b * error_y) / det, (a * error_y - b * error_x) / det
            # Far outside the image, where the lens model folds back, a full step can diverge; inside
            # the image no step is this long.
            length = xp.sqrt(step_x * step_x + step_y * step_y + xp.finfo(step_x.dtype).tiny)
            shorter = xp.minimum(1.0, 0.5 / length)
            return x - step_x * shorter, y - step_y * shorter

        x, y = solve_by_newton(xp, newton, newton, (x, y), (x, y, self.distortion))
        length = xp.sqrt(x * x + y * y + 1.0)
        return xp.stack([x / length, y / length, 1.0 / length], -1)

    @staticmethod
    def fit_curve(
        theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "lenses values"]:
        slope = np.tan(theta)
        return np.array([[radius @ slope / (slope @ slope), *np.zeros(8)]])

    def matrix(self) -> Float[Array, "3 3"]:
        """The paper's camera matrix A [px]. Source: the paper, equation (1)."""
        xp = namespace(self)
        zero, one = xp.zeros_like(self.fx), xp.ones_like(self.fx)
        return xp.stack([self.fx, self.skew, self.cx, zero, self.fy, self.cy, zero, zero, one]).reshape(3, 3)


def _plane(xp: Any, p: Array) -> tuple[Component, Component, Component]:
    """x = X / Z, y = Y / Z, and Z; 1 where Z is 0, so that neither value nor gradient is NaN there."""
    z = xp.where(p[..., 2] == 0, 1.0, p[..., 2]).astype(p.dtype)
    return p[..., 0] / z, p[..., 1] / z, z


def _distort(x: Component, y: Component, k: Float[Array, " k"]) -> tuple[Component, Component]:
    r2, xy = x * x + y * y, 2.0 * x * y
    radial = _radial(r2, k)[0]
    return x * radial + k[2] * xy + k[3] * (r2 + 2.0 * x * x), y * radial + k[2] * (r2 + 2.0 * y * y) + k[3] * xy


def _distort_slopes(x: Component, y: Component, k: Float[Array, " k"]) -> tuple[Component, Component, Component]:
    """d x' / dx, d x' / dy = d y' / dx, and d y' / dy."""
    radial, rise = _radial(x * x + y * y, k)
    across = 2.0 * (x * y * rise + k[2] * x + k[3] * y)
    along_x = radial + 2.0 * x * x * rise + 2.0 * k[2] * y + 6.0 * k[3] * x
    along_y = radial + 2.0 * y * y * rise + 6.0 * k[2] * y + 2.0 * k[3] * x
    return along_x, across, along_y


def _radial(r2: Component, k: Float[Array, " k"]) -> tuple[Component, Component]:
    """R, and its derivative by r^2."""
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    rise = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])
    if k.shape[0] == 8:
        below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        radial = radial / below
        rise = (rise - radial * (k[5] + r2 * (2.0 * k[6] + 3.0 * r2 * k[7]))) / below
    return radial, rise
