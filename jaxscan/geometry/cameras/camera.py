"""The base class of the camera models: projection, its inverse, and parameters."""

import abc
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, ArrayModule, namespace, real
from jaxscan.geometry.parameters import ParameterBlock


FOCAL = (
    # The prior is for the aspect fx / fy, not for fx.
    ParameterBlock("focal", ("fx",), 100.0, "px", prior="aspect", sigma=2e-3, expected=1.0),
    ParameterBlock("focal", ("fy",), 100.0, "px"),
)
"""Focal lengths of every camera."""
CENTRE = (ParameterBlock("centre", ("cx", "cy"), 20.0, "px", prior="centre_px", sigma=50.0),)
"""Principal point of every camera; expected in the middle of the image."""


class AbstractCamera(ArrayModule):
    """A central camera: one pixel, one ray through the centre of projection.

    Its minimal coordinates are fx, fy, cx, cy and the coefficients of its lens, in this order. A
    model adds its name, the blocks of its coefficients, the projection with its slopes and its
    inverse, and first values from a radial curve. All three are written component by component, for
    any leading axes, in the functions of a `namespace`: JAX's or NumPy's. `CAMERAS` lists the models.
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
    """Image width [px]; 0 in a `Rig`."""
    height: int = eqx.field(static=True)
    """Image height [px]; 0 in a `Rig`."""

    def __check_init__(self) -> None:
        every = sum(len(block.parameters) for block in self.lens)
        counts = sorted({every - sum(len(block.parameters) for block in self.lens if block.optional), every})
        if np.shape(self.distortion) not in [(count,) for count in counts]:
            wanted = " or ".join(map(str, counts))
            raise ValueError(f"`distortion` must have {wanted} coefficients, got shape {np.shape(self.distortion)}.")

    @abc.abstractmethod
    def project(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Pixels at which points `p` [camera frame, any length unit] are seen [px]."""

    @abc.abstractmethod
    def slopes(self, p: Float[Array, "*n 3"]) -> Float[Array, "*n 2 3"]:
        """Derivatives of `project` by the point [px per length unit]."""

    @abc.abstractmethod
    def unproject(self, q: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Unit rays [camera frame] of the pixels `q` [px]."""

    @staticmethod
    @abc.abstractmethod
    def fit_curve(
        theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "lenses values"]:
        """Fit the lens to radii [px] measured at angles to the optical axis [rad]: first values for a solve.

        There may be several nearly equal solutions; the solve tries each.

        Returns:
            For each lens the focal length [px], then all coefficients, with the optional ones [1].
        """

    def without_size(self) -> "AbstractCamera":
        """The same lens for images of any size, so that what is compiled for it serves all."""
        return replace(self, width=0, height=0)

    @classmethod
    def blocks(cls) -> tuple[ParameterBlock, ...]:
        """Blocks of all minimal coordinates, with the optional ones."""
        return FOCAL + CENTRE + cls.lens

    def parameter_names(self) -> tuple[str, ...]:
        """Names of the minimal coordinates, in the order of `retract`."""
        names = [name for block in self.blocks() for name in block.parameters]
        return tuple(names[: 4 + np.shape(self.distortion)[-1]])

    def parameters(self) -> Float[Array, " params"]:
        """Values of the minimal coordinates [px; 1 for distortion]."""
        xp = namespace(self)
        return xp.concatenate([xp.stack([self.fx, self.fy, self.cx, self.cy]), self.distortion])

    def prior_values(self) -> Float[Array, " params"]:
        """The values that the priors are for: the minimal coordinates, with the aspect fx / fy in place of fx."""
        values = self.parameters()
        return namespace(values).concatenate([(self.fx / self.fy)[None], values[1:]])

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
