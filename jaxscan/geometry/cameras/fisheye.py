"""The fisheye camera: the angle to the optical axis, not its tangent, becomes the radius."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, Component, namespace, real, solve_by_newton
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

    the pixel is $u = \theta_d (f_x \cos\psi + s \sin\psi) + c_x$, $v = f_y \theta_d \sin\psi + c_y$, where
    $\psi$ is the direction of $(X, Y)$; OpenCV writes the skew as $s = f_x \alpha$.

    Source: Kannala and Brandt, A generic camera model and calibration method for conventional,
    wide-angle, and fish-eye lenses (2006), equation (6); scaled as OpenCV's fisheye module does.
    """

    model: ClassVar[str] = "fisheye"
    lens: ClassVar[tuple[ParameterBlock, ...]] = (
        ParameterBlock("radial", ("k1", "k2"), 0.1),
        ParameterBlock("radial", ("k3", "k4"), 0.1, prior="k3", sigma=1.0),
    )
    wide: ClassVar[bool] = True

    skew: Float[Array, ""] = eqx.field(default=0.0, converter=real)
    """Skew s of the pixel axes [px]; known, never estimated."""

    def project(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Pixels of points [px].

        Undefined only straight behind the camera, and beyond the angle at which the polynomial
        folds back.
        """
        xp = namespace(self, p)
        per_radius, square = _angle(xp, *(p[..., k] for k in range(3)))
        scale = per_radius * _factor(square, self.distortion)
        x, y = scale * p[..., 0], scale * p[..., 1]
        return xp.stack([self.fx * x + self.skew * y + self.cx, self.fy * y + self.cy], -1)

    def slopes(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2 3"]:
        """Derivatives of `project` by the point [px per length unit]."""
        xp = namespace(self, p)
        x, y, z = (p[..., k] for k in range(3))
        per_radius, square = _angle(xp, x, y, z)
        scale, rise = per_radius * _factor(square, self.distortion), _slope(square, self.distortion)
        radius2 = x * x + y * y
        far2 = radius2 + z * z
        far2 = xp.where(far2 > 0, far2, 1.0).astype(p.dtype)
        # d (theta_d / radius) / d radius, over the radius; next to the axis it is multiplied by next to nothing.
        bend = xp.where(radius2 > 0, (rise * z / far2 - scale) / xp.where(radius2 > 0, radius2, 1.0), 0.0)
        bend, back = bend.astype(p.dtype), -rise / far2
        aside = xp.stack([scale + bend * x * x, bend * x * y, back * x], -1)
        down = xp.stack([bend * x * y, scale + bend * y * y, back * y], -1)
        return xp.stack([self.fx * aside + self.skew * down, self.fy * down], -2)

    def unproject(self, q: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Unit rays of pixels, by Newton's method: 1e-10 px in float64, 1e-3 px in float32.

        Pixels outside the image of the lens get the ray of the largest angle on their side.
        """
        xp = namespace(self, q)
        y = (q[..., 1] - self.cy) / self.fy
        x = (q[..., 0] - self.cx - self.skew * y) / self.fx
        last, reach = _fold(xp, self.distortion if xp is np else jax.lax.stop_gradient(self.distortion))
        target = x * x + y * y
        beyond = target > reach
        inwards = xp.sqrt(xp.where(beyond, reach / xp.where(beyond, target, 1.0), 1.0).astype(target.dtype))
        square = _invert(xp, xp.where(beyond, reach, target).astype(target.dtype), self.distortion, last)
        sinc, cosine = _sine_and_cosine(xp, square)
        scale = inwards * sinc / _factor(square, self.distortion)
        x, y = scale * x, scale * y
        # Unit but for rounding.
        length = xp.sqrt(x * x + y * y + cosine * cosine)
        return xp.stack([x / length, y / length, cosine / length], -1)

    @staticmethod
    def fit_curve(
        theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "lenses values"]:
        focal, cubic = np.linalg.lstsq(np.column_stack([theta, theta**3]), radius, rcond=None)[0]
        return np.array([[focal, cubic / focal, 0.0, 0.0, 0.0]])


def _angle(xp: Any, x: Component, y: Component, z: Component) -> tuple[Component, Component]:
    """theta over the radius hypot(x, y), and theta squared; both smooth where the radius is 0 and z > 0."""
    radius2, z2 = x * x + y * y, z * z
    near = (z > 0) & (radius2 < _SMALL_SLOPE * z2)
    # Straight behind the camera the direction is undefined; 1 keeps value and gradient finite.
    lost = (z <= 0) & (radius2 <= xp.finfo(z.dtype).eps ** 2 * z2)
    safe_z = xp.where(near, z, 1.0).astype(z.dtype)
    slope2 = xp.where(near, radius2, 0.0).astype(z.dtype) / (safe_z * safe_z)
    series = 1.0 - slope2 * (1 / 3 - slope2 * (1 / 5 - slope2 / 7))
    radius = xp.sqrt(xp.where(near | lost, 1.0, radius2).astype(z.dtype))
    theta = xp.arctan2(radius, xp.where(near, 1.0, z).astype(z.dtype))
    per_radius = xp.where(near, series / safe_z, theta / radius).astype(z.dtype)
    return per_radius, xp.where(near, slope2 * series * series, theta * theta).astype(z.dtype)


def _factor(square: Component, k: Float[Array, "4"]) -> Component:
    """theta_d / theta, of theta squared."""
    return 1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))


def _slope(square: Component, k: Float[Array, "4"]) -> Component:
    """d theta_d / d theta, of theta squared."""
    return 1.0 + square * (3.0 * k[0] + square * (5.0 * k[1] + square * (7.0 * k[2] + square * (9.0 * k[3]))))


def _invert(xp: Any, target: Component, k: Float[Array, "4"], last: Component) -> Component:
    """theta squared of theta_d squared, up to `last`."""

    def newton(point, parameters):
        (square,), (target, k) = point, parameters
        factor = _factor(square, k)
        # d (theta_d^2) / d (theta^2) = (theta_d / theta) d theta_d / d theta
        slope = factor * _slope(square, k)
        slope = xp.where(slope > 0, slope, 1.0).astype(slope.dtype)
        return (square - (square * factor * factor - target) / slope,)

    def closer(point, parameters):
        # Near the fold a full step can leave the branch for good, so a step goes at most half way to
        # an end of the branch.
        (square,), (after,) = point, newton(point, parameters)
        return (xp.clip(after, 0.5 * square, 0.5 * (square + last)),)

    return solve_by_newton(xp, closer, newton, (xp.minimum(target, last),), (target, k))[0]


def _fold(xp: Any, k: Float[Array, "4"]) -> tuple[Component, Component]:
    """theta squared and theta_d squared at the end of the growth of theta_d, at most at theta = pi."""
    square: Any = xp.linspace(0.0, np.pi**2, _FOLD_GRID, dtype=k.dtype)
    slope: Any = _slope(square, k)
    falling: Any = slope <= 0
    after = xp.argmax(falling)
    before = xp.maximum(after - 1, 0)
    down = xp.where(falling[after], slope[before] - slope[after], 1.0).astype(k.dtype)
    crossing = square[before] + slope[before] / down * (square[after] - square[before])
    last = xp.where(falling[after], crossing, square[-1]).astype(k.dtype)
    factor = _factor(last, k)
    return last, last * factor * factor


def _sine_and_cosine(xp: Any, square: Component) -> tuple[Component, Component]:
    """sin(theta) / theta and cos(theta) of theta squared, smooth at 0."""
    near = square < _SMALL_SQUARE
    s = xp.where(near, square, 0.0).astype(square.dtype)
    sinc = 1.0 - s / 6 * (1.0 - s / 20 * (1.0 - s / 42 * (1.0 - s / 72)))
    cosine = 1.0 - s / 2 * (1.0 - s / 12 * (1.0 - s / 30 * (1.0 - s / 56 * (1.0 - s / 90))))
    theta = xp.sqrt(xp.where(near, 1.0, square).astype(square.dtype))
    pick = lambda series, far: xp.where(near, series, far).astype(square.dtype)
    return pick(sinc, xp.sin(theta) / theta), pick(cosine, xp.cos(theta))
