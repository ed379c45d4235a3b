"""Cameras: where a point is seen, and along which ray a pixel looks."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, real


class AbstractCamera(eqx.Module):
    """A central camera: one pixel, one ray through the centre of projection."""

    width: eqx.AbstractVar[int]
    height: eqx.AbstractVar[int]

    @abc.abstractmethod
    def project(self, p: Float[Array, "3"]) -> Float[Array, "2"]:
        """Pixel at which the point `p` [camera frame, any length unit] is seen [px]."""

    @abc.abstractmethod
    def unproject(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit ray [camera frame] along which the pixel `q` [px] looks."""

    @abc.abstractmethod
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the minimal coordinates, in the order that `retract` takes them."""

    @abc.abstractmethod
    def parameters(self) -> Float[Array, " params"]:
        """Values of the minimal coordinates [px; 1 for distortion]."""

    @abc.abstractmethod
    def retract(self, step: Float[Array, " params"]) -> "AbstractCamera":
        """This camera moved by `step` in its minimal coordinates [px; 1 for distortion]."""


class Pinhole(AbstractCamera):
    r"""Pinhole with Brown-Conrady distortion.

    With $x = X/Z$, $y = Y/Z$, $r^2 = x^2 + y^2$ and the radial factor

    $$R = \frac{1 + k_1 r^2 + k_2 r^4 + k_3 r^6}{1 + k_4 r^2 + k_5 r^4 + k_6 r^6}$$

    the pixel is $u = f_x x' + s y' + c_x$, $v = f_y y' + c_y$ with
    $x' = x R + 2 p_1 x y + p_2 (r^2 + 2 x^2)$ and
    $y' = y R + p_1 (r^2 + 2 y^2) + 2 p_2 x y$.

    Source: PAPER.md equations (1)-(3), of which this is the general case (there $k = k_1$);
    the order of the coefficients is OpenCV's.
    """

    fx: Float[Array, ""] = eqx.field(converter=real)
    """Focal length along u [px]."""
    fy: Float[Array, ""] = eqx.field(converter=real)
    """Focal length along v [px]."""
    cx: Float[Array, ""] = eqx.field(converter=real)
    """Principal point, u [px]."""
    cy: Float[Array, ""] = eqx.field(converter=real)
    """Principal point, v [px]."""
    distortion: Float[Array, " k"] = eqx.field(converter=real)
    """k1 k2 p1 p2 k3, optionally followed by k4 k5 k6 [1]."""
    width: int = eqx.field(static=True)
    """Image width [px]."""
    height: int = eqx.field(static=True)
    """Image height [px]."""
    skew: Float[Array, ""] = eqx.field(default=0.0, converter=real)
    """Skew s of the pixel axes [px]; known, never estimated."""

    def __check_init__(self) -> None:
        if np.shape(self.distortion) not in ((5,), (8,)):
            raise ValueError(f"`distortion` must have 5 or 8 coefficients, got shape {np.shape(self.distortion)}.")

    def project(self, p: Float[Array, "3"]) -> Float[Array, "2"]:
        """Pixel of a point [px].

        Continuous but without meaning for points at or behind the camera plane.
        """
        # A harmless 1 where z is 0, so that neither value nor gradient is NaN there.
        z = jnp.where(p[2] == 0, 1.0, p[2]).astype(p.dtype)
        x = _distort(p[:2] / z, self.distortion)
        return jnp.stack([self.fx * x[0] + self.skew * x[1] + self.cx, self.fy * x[1] + self.cy])

    def unproject(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit ray of a pixel, by Newton's method: 1e-10 px in float64, 1e-3 px in float32."""
        y = (q[1] - self.cy) / self.fy
        x = (q[0] - self.cx - self.skew * y) / self.fx
        normalised = _undistort(jnp.stack([x, y]), jnp.asarray(self.distortion))
        ray = jnp.append(normalised, jnp.ones((), normalised.dtype))
        return ray / jnp.linalg.norm(ray)

    def parameter_names(self) -> tuple[str, ...]:
        names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        return names[: 4 + np.shape(self.distortion)[-1]]

    def parameters(self) -> Float[Array, " params"]:
        pixels = jnp.stack([jnp.asarray(value) for value in (self.fx, self.fy, self.cx, self.cy)])
        return jnp.concatenate([pixels, jnp.asarray(self.distortion)])

    def retract(self, step: Float[Array, " params"]) -> "Pinhole":
        return Pinhole(
            fx=self.fx + step[0],
            fy=self.fy + step[1],
            cx=self.cx + step[2],
            cy=self.cy + step[3],
            distortion=self.distortion + step[4:],
            width=self.width,
            height=self.height,
            skew=self.skew,
        )

    def matrix(self) -> Float[Array, "3 3"]:
        """The paper's camera matrix A [px]. Source: PAPER.md equation (1)."""
        zero, one = jnp.zeros_like(self.fx), jnp.ones_like(self.fx)
        return jnp.stack(
            [
                jnp.stack([self.fx, self.skew, self.cx]),
                jnp.stack([zero, self.fy, self.cy]),
                jnp.stack([zero, zero, one]),
            ]
        )


def _distort(x: Float[Array, "2"], k: Float[Array, " k"]) -> Float[Array, "2"]:
    return jnp.stack(_distort_xy(x[0], x[1], k))


def _distort_xy(x: Array, y: Array, k: Float[Array, " k"]) -> tuple[Array, Array]:
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    if k.shape[0] == 8:
        radial = radial / (1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    xy = 2.0 * x * y
    return x * radial + k[2] * xy + k[3] * (r2 + 2.0 * x * x), y * radial + k[2] * (r2 + 2.0 * y * y) + k[3] * xy


def _undistort(target: Float[Array, "2"], k: Float[Array, " k"]) -> Float[Array, "2"]:
    """Solve `_distort(x, k) = target`.

    The coordinates are kept apart: as the fastest axis of an array of millions of points, a pair
    would keep the loop from being vectorised (3.5 times slower).
    """

    def newton(x, y, k, target_x, target_y):
        one, zero = jnp.ones_like(x), jnp.zeros_like(x)
        (distorted_x, distorted_y), (a, c) = jax.jvp(lambda x, y: _distort_xy(x, y, k), (x, y), (one, zero))
        _, (b, d) = jax.jvp(lambda x, y: _distort_xy(x, y, k), (x, y), (zero, one))
        error_x, error_y = distorted_x - target_x, distorted_y - target_y
        det = a * d - b * c
        det = jnp.where(det == 0, 1.0, det).astype(det.dtype)
        step_x, step_y = (d * error_x - b * error_y) / det, (a * error_y - c * error_x) / det
        # Far outside the image, where the lens model folds over, a full step can leave the
        # basin for good; inside it no step is this long.
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
