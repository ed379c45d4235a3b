"""A camera: where a point is seen, along which ray a pixel looks, and which parameters it has."""

import abc
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, real
from jaxscan.geometry.parameters import ParameterBlock


FOCAL = (
    # In place of fx, its prior speaks of the aspect fx / fy.
    ParameterBlock("focal", ("fx",), 100.0, "px", prior="aspect", sigma=2e-3, expected=1.0),
    ParameterBlock("focal", ("fy",), 100.0, "px"),
)
"""Focal lengths of every camera."""
CENTRE = (ParameterBlock("centre", ("cx", "cy"), 20.0, "px", prior="centre_px", sigma=50.0),)
"""Principal point of every camera; expected in the middle of the image."""


class AbstractCamera(eqx.Module):
    """A central camera: one pixel, one ray through the centre of projection.

    Its minimal coordinates are fx, fy, cx, cy and the coefficients of its lens, in this order. A
    model adds its name, the blocks of its coefficients, the projection and its inverse, and a
    first camera from a radial curve. `CAMERAS` in `registry.py` lists the models.
    """

    model: eqx.AbstractClassVar[str]
    """Name of the model, in files and on the command line."""
    lens: eqx.AbstractClassVar[tuple[ParameterBlock, ...]]
    """Blocks of the coefficients, in the order of `distortion`; optional ones last."""
    wide: eqx.AbstractClassVar[bool]
    """Whether the model holds beyond 90 degrees from the optical axis."""
    fx: Float[Array, ""] = eqx.field(converter=real)
    """Focal length along u [px]."""
    fy: Float[Array, ""] = eqx.field(converter=real)
    """Focal length along v [px]."""
    cx: Float[Array, ""] = eqx.field(converter=real)
    """Principal point, u [px]."""
    cy: Float[Array, ""] = eqx.field(converter=real)
    """Principal point, v [px]."""
    distortion: Float[Array, " k"] = eqx.field(converter=real)
    """Coefficients of the lens, in the order of its blocks [1]."""
    width: int = eqx.field(static=True)
    """Image width [px]."""
    height: int = eqx.field(static=True)
    """Image height [px]."""

    def __check_init__(self) -> None:
        every = sum(len(block.parameters) for block in self.lens)
        counts = sorted({every - sum(len(block.parameters) for block in self.lens if block.optional), every})
        if np.shape(self.distortion) not in [(count,) for count in counts]:
            wanted = " or ".join(map(str, counts))
            raise ValueError(f"`distortion` must have {wanted} coefficients, got shape {np.shape(self.distortion)}.")

    @abc.abstractmethod
    def project(self, p: Float[Array, "3"]) -> Float[Array, "2"]:
        """Pixel at which the point `p` [camera frame, any length unit] is seen [px]."""

    @abc.abstractmethod
    def unproject(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit ray [camera frame] along which the pixel `q` [px] looks."""

    @staticmethod
    @abc.abstractmethod
    def fit_curve(
        theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "lenses values"]:
        """The lens that shows angles to the optical axis at given radii: first values for a solve.

        Several where the model has several that are nearly the same: the solve tries each.

        Args:
            theta: Angles to the optical axis [rad].
            radius: Distances from the principal point at which they are seen [px].

        Returns:
            Of each lens the focal length [px], then all coefficients, optional ones too [1].
        """

    @classmethod
    def blocks(cls) -> tuple[ParameterBlock, ...]:
        """Descriptions of all minimal coordinates, optional ones too."""
        return FOCAL + CENTRE + cls.lens

    def parameter_names(self) -> tuple[str, ...]:
        """Names of the minimal coordinates, in the order that `retract` takes them."""
        names = [name for block in self.blocks() for name in block.parameters]
        return tuple(names[: 4 + np.shape(self.distortion)[-1]])

    def parameters(self) -> Float[Array, " params"]:
        """Values of the minimal coordinates [px; 1 for distortion]."""
        pixels = jnp.stack([jnp.asarray(value) for value in (self.fx, self.fy, self.cx, self.cy)])
        return jnp.concatenate([pixels, jnp.asarray(self.distortion)])

    def prior_values(self) -> Float[Array, " params"]:
        """The minimal coordinates as their priors speak of them: in place of fx the aspect fx / fy."""
        return jnp.asarray(self.parameters()).at[0].set(self.fx / self.fy)

    def retract(self, step: Float[Array, " params"]) -> "AbstractCamera":
        """This camera moved by `step` in its minimal coordinates [px; 1 for distortion]."""
        return replace(
            self,
            fx=self.fx + step[0],
            fy=self.fy + step[1],
            cx=self.cx + step[2],
            cy=self.cy + step[3],
            distortion=self.distortion + step[4:],
        )
