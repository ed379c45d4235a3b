"""The pinhole camera with the distortion of Brown and Conrady."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, functions_of, real
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

    def project(self, p: Float[Array, "3 *points"]) -> Float[Array, "2 *points"]:
        """Pixel of a point [px].

        Continuous but meaningless for points on or behind the camera plane.
        """
        # 1 where z is 0, so that neither value nor gradient is NaN there.
        numeric = functions_of(p, self.fx)
        z = numeric.where(p[2] == 0, 1.0, p[2]).astype(p.dtype)
        x, y = _distort(p[0] / z, p[1] / z, self.distortion)
        return numeric.stack([self.fx * x + self.skew * y + self.cx, self.fy * y + self.cy])

    def unproject(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit ray of a pixel, by Newton's method: 1e-10 px in float64, 1e-3 px in float32."""
        y = (q[1] - self.cy) / self.fy
        x = (q[0] - self.cx - self.skew * y) / self.fx
        normalised = _undistort(jnp.stack([x, y]), jnp.asarray(self.distortion))
        ray = jnp.append(normalised, jnp.ones((), normalised.dtype))
        return ray / jnp.linalg.norm(ray)

    @staticmethod
    def fit_curve(
        theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "lenses values"]:
        slope = np.tan(theta)
        return np.array([[radius @ slope / (slope @ slope), *np.zeros(8)]])

    def matrix(self) -> Float[Array, "3 3"]:
        """The paper's camera matrix A [px]. Source: the paper, equation (1)."""
        zero, one = jnp.zeros_like(self.fx), jnp.ones_like(self.fx)
        return jnp.stack([self.fx, self.skew, self.cx, zero, self.fy, self.cy, zero, zero, one]).reshape(3, 3)


def _distort(x: Array, y: Array, k: Float[Array, " k"]) -> tuple[Array, Array]:
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    if k.shape[0] == 8:
        radial = radial / (1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    xy = 2.0 * x * y
    return x * radial + k[2] * xy + k[3] * (r2 + 2.0 * x * x), y * radial + k[2] * (r2 + 2.0 * y * y) + k[3] * xy


def _undistort(target: Float[Array, "2"], k: Float[Array, " k"]) -> Float[Array, "2"]:
    """Solve `_distort(x, y, k) = target`.

    The coordinates are separate arrays: with (x, y) as the last axis of one array the loop is not
    vectorised (3.5 times slower).
    """

    def newton(x, y, k, target_x, target_y):
        one, zero = jnp.ones_like(x), jnp.zeros_like(x)
        (distorted_x, distorted_y), (a, c) = jax.jvp(lambda x, y: _distort(x, y, k), (x, y), (one, zero))
        _, (b, d) = jax.jvp(lambda x, y: _distort(x, y, k), (x, y), (zero, one))
        error_x, error_y = distorted_x - target_x, distorted_y - target_y
        det = a * d - b * c
        det = jnp.where(det == 0, 1.0, det).astype(det.dtype)
        step_x, step_y = (d * error_x - b * error_y) / det, (a * error_y - c * error_x) / det
        # Far outside the image, where the lens model folds back, a full step can diverge; inside
        # the image no step is this long.
        length = jnp.sqrt(step_x * step_x + step_y * step_y + jnp.finfo(step_x.dtype).tiny)
        shorter = jnp.minimum(1.0, 0.5 / length)
        return x - step_x * shorter, y - step_y * shorter

    fixed_k, fixed = jax.lax.stop_gradient((k, target))
    iterations = 4 if target.dtype == jnp.float32 else 12
    x, y = jax.lax.fori_loop(
        0, iterations, lambda _, p: newton(p[0], p[1], fixed_k, fixed[0], fixed[1]), (fixed[0], fixed[1])
    )
    # One last step carries the derivative: at the solution it is the implicit function theorem.
    x, y = jax.lax.stop_gradient((x, y))
    return jnp.stack(newton(x, y, k, target[0], target[1]))
