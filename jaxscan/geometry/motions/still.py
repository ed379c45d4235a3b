"""No motion: a profile scanner that stands still, or a camera alone."""

from typing import ClassVar

import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, namespace
from jaxscan.geometry.motions.motion import AbstractMotion, Carries
from jaxscan.geometry.parameters import ParameterBlock


class Still(AbstractMotion):
    """The camera stays where it is; the scanner frame is the camera frame."""

    blocks: ClassVar[tuple[ParameterBlock, ...]] = ()

    @property
    def carries(self) -> Carries:
        """Its name in files."""
        return "nothing"

    def motion(self, s: Float[Array, "*n"]) -> Float[Array, "*n 4 4"]:
        """The identity."""
        xp = namespace(s)
        return xp.broadcast_to(xp.eye(4, dtype=s.dtype), (*s.shape, 4, 4))

    def twist(self) -> Float[Array, "6"]:
        """No motion."""
        return np.zeros(6)

    def frame(self) -> Float[Array, "4 4"]:
        """T_scanner_cam: the identity."""
        return np.eye(4, dtype=np.float32)

    def retract(self, step: Float[Array, " params"]) -> "Still":
        """The same: there is nothing to move."""
        return self

    def prior_values(self) -> Float[Array, " params"]:
        """None."""
        return np.zeros(0)

    def departure(self, other: AbstractMotion) -> Float[np.ndarray, " params"]:
        """None."""
        return np.zeros(0)

    def pointed(self, up: Float[Array, "3"]) -> "Still":
        """The same."""
        return self

    def carrying(self, carries: Carries) -> "Still":
        """The same."""
        return self
