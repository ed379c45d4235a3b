"""The fisheye camera: the angle to the optical axis, not its tangent, becomes the radius."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, functions_of
from jaxscan.geometry.cameras.camera import AbstractCamera
from jaxscan.geometry.parameters import ParameterBlock


# Points of the search for the angle at which the polynomial folds back.
_FOLD_GRID = 129
# Below these limits the power series in this file are exact to float64 rounding.
_SMALL_SLOPE = 1e-4
_SMALL_SQUARE = 1e-2


class Fisheye(AbstractCamera):
    r"""Fisheye after Kannala and Brandt, radially symmetric; sees beyond 90 degrees.

    With $\theta = \mathrm{atan2}(\sqrt{X^2 + Y^2}, Z)$ and

    $$\theta_d = \theta (1 + k_1 \theta^2 + k_2 \theta^4 + k_3 \theta^6 + k_4 \theta^8)$$

    the pixel is $u = f_x \theta_d \cos\psi + c_x$, $v = f_y \theta_d \sin\psi + c_y$, where $\psi$
    is the direction of $(X, Y)$.

    Source: Kannala and Brandt, A generic camera model and calibration method for conventional,
    wide-angle, and fish-eye lenses (2006), equation (6); scaled as OpenCV's fisheye module does.
    """

    model: ClassVar[str] = "fisheye"
    lens: ClassVar[tuple[ParameterBlock, ...]] = (
        ParameterBlock("radial", ("k1", "k2"), 0.1),
        ParameterBlock("radial", ("k3", "k4"), 0.1, prior="k3", sigma=1.0),
    )
    wide: ClassVar[bool] = True

    def project(self, p: Float[Array, "3 *points"]) -> Float[Array, "2 *points"]:
        """Pixel of a point [px].

        Undefined only straight behind the camera, and beyond the angle at which the polynomial
        folds back.
        """
        numeric = functions_of(p, self.fx)
        per_radius, square = _angle(p[0], p[1], p[2], numeric)
        scale = per_radius * _factor(square, self.distortion)
        return numeric.stack([self.fx * (scale * p[0]) + self.cx, self.fy * (scale * p[1]) + self.cy])

    def unproject(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit ray of a pixel, by Newton's method: 1e-10 px in float64, 1e-3 px in float32.

        Pixels outside the image of the lens get the ray of the largest angle on their side.
        """
        x, y = (q[0] - self.cx) / self.fx, (q[1] - self.cy) / self.fy
        k = jnp.asarray(self.distortion)
        last, reach = _fold(jax.lax.stop_gradient(k))
        target = x * x + y * y
        beyond = target > reach
        inwards = jnp.sqrt(jnp.where(beyond, reach / jnp.where(beyond, target, 1.0), 1.0).astype(target.dtype))
        square = _invert(jnp.where(beyond, reach, target).astype(target.dtype), k, last)
        sinc, cosine = _sine_and_cosine(square)
        scale = inwards * sinc / _factor(square, k)
        ray = jnp.stack([scale * x, scale * y, cosine])
        # Unit but for rounding.
        return ray / jnp.linalg.norm(ray)

    @staticmethod
    def fit_curve(
        theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "lenses values"]:
        focal, cubic = np.linalg.lstsq(np.column_stack([theta, theta**3]), radius, rcond=None)[0]
        return np.array([[focal, cubic / focal, 0.0, 0.0, 0.0]])


def _angle(x: Array, y: Array, z: Array, numeric: Any = jnp) -> tuple[Array, Array]:
    """theta over the radius hypot(x, y), and theta squared; both smooth where the radius is 0 and z > 0."""
    radius2, z2 = x * x + y * y, z * z
    near = (z > 0) & (radius2 < _SMALL_SLOPE * z2)
    # Straight behind the camera the direction is undefined; 1 keeps value and gradient finite.
    lost = (z <= 0) & (radius2 <= numeric.finfo(z.dtype).eps ** 2 * z2)
    safe_z = numeric.where(near, z, 1.0).astype(z.dtype)
    slope2 = numeric.where(near, radius2, 0.0).astype(z.dtype) / (safe_z * safe_z)
    series = 1.0 - slope2 * (1 / 3 - slope2 * (1 / 5 - slope2 / 7))
    radius = numeric.sqrt(numeric.where(near | lost, 1.0, radius2).astype(z.dtype))
    theta = numeric.arctan2(radius, numeric.where(near, 1.0, z).astype(z.dtype))
    per_radius = numeric.where(near, series / safe_z, theta / radius).astype(z.dtype)
    return per_radius, numeric.where(near, slope2 * series * series, theta * theta).astype(z.dtype)


def _factor(square: Array, k: Float[Array, "4"]) -> Array:
    """theta_d / theta, of theta squared."""
    return 1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))


def _slope(square: Array, k: Float[Array, "4"]) -> Array:
    """d theta_d / d theta, of theta squared."""
    return 1.0 + square * (3.0 * k[0] + square * (5.0 * k[1] + square * (7.0 * k[2] + square * (9.0 * k[3]))))


def _invert(target: Array, k: Float[Array, "4"], last: Array) -> Array:
    """theta squared of theta_d squared, up to `last`.

    The relation of the squares is a polynomial. It is smooth at the optical axis too, where the
    angle itself is not.
    """

    def newton(square, k, target):
        factor = _factor(square, k)
        # d (theta_d^2) / d (theta^2) = (theta_d / theta) d theta_d / d theta
        slope = factor * _slope(square, k)
        slope = jnp.where(slope > 0, slope, 1.0).astype(slope.dtype)
        return (square * factor * factor - target) / slope

    fixed_k, fixed = jax.lax.stop_gradient((k, target))

    def closer(_, square):
        # Near the fold a full step can leave the branch for good, so a step goes at most half way to
        # an end of the branch.
        return jnp.clip(square - newton(square, fixed_k, fixed), 0.5 * square, 0.5 * (square + last))

    iterations = 5 if target.dtype == jnp.float32 else 12
    square = jax.lax.fori_loop(0, iterations, closer, jnp.minimum(fixed, last))
    # One last step carries the derivative: at the solution it is the implicit function theorem.
    square = jax.lax.stop_gradient(square)
    return square - newton(square, k, target)


def _fold(k: Float[Array, "4"]) -> tuple[Array, Array]:
    """theta squared and theta_d squared at the end of the growth of theta_d, at most at theta = pi."""
    square = jnp.linspace(0.0, np.pi**2, _FOLD_GRID, dtype=k.dtype)
    slope = _slope(square, k)
    falling = slope <= 0
    after = jnp.argmax(falling)
    before = jnp.maximum(after - 1, 0)
    down = jnp.where(falling[after], slope[before] - slope[after], 1.0).astype(k.dtype)
    crossing = square[before] + slope[before] / down * (square[after] - square[before])
    last = jnp.where(falling[after], crossing, square[-1]).astype(k.dtype)
    factor = _factor(last, k)
    return last, last * factor * factor


def _sine_and_cosine(square: Array) -> tuple[Array, Array]:
    """sin(theta) / theta and cos(theta) of theta squared, smooth at 0."""
    near = square < _SMALL_SQUARE
    s = jnp.where(near, square, 0.0).astype(square.dtype)
    sinc = 1.0 - s / 6 * (1.0 - s / 20 * (1.0 - s / 42 * (1.0 - s / 72)))
    cosine = 1.0 - s / 2 * (1.0 - s / 12 * (1.0 - s / 30 * (1.0 - s / 56 * (1.0 - s / 90))))
    theta = jnp.sqrt(jnp.where(near, 1.0, square).astype(square.dtype))
    pick = lambda series, far: jnp.where(near, series, far).astype(square.dtype)
    return pick(sinc, jnp.sin(theta) / theta), pick(cosine, jnp.cos(theta))
