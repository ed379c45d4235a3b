"""The base class of the motions: where the camera is at every position, and parameters."""

import abc
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, ArrayModule
from jaxscan.geometry.parameters import ParameterBlock


Carries = Literal["scanner", "object", "linear", "nothing"]
"""The turning part of a turntable; a linear stage; or no motion."""


class AbstractMotion(ArrayModule):
    """A motion with one position s per record: the table's angle [rad], or the place of a stage [m].

    At position 0 the camera is where it defines the rig. A motion adds its name, its blocks and these methods.
    """

    blocks: eqx.AbstractClassVar[tuple[ParameterBlock, ...]]
    """Blocks of its minimal coordinates, in the order of `retract`."""

    @property
    @abc.abstractmethod
    def carries(self) -> Carries:
        """Its name in files."""

    @abc.abstractmethod
    def motion(self, s: Float[Array, "*n"]) -> Float[Array, "*n 4 4"]:
        """T_cam0_cam(s) of any positions: from camera coordinates at position `s` [rad or m] to those at position 0."""

    @abc.abstractmethod
    def twist(self) -> Float[Array, "6"]:
        """Twist (v, omega) of the camera for a motion by 1 rad or 1 m."""

    @abc.abstractmethod
    def frame(self) -> Float[Array, "4 4"]:
        """T_scanner_cam at position 0."""

    @abc.abstractmethod
    def retract(self, step: Float[Array, " params"]) -> "AbstractMotion":
        """This motion moved by `step` in its minimal coordinates."""

    @abc.abstractmethod
    def prior_values(self) -> Float[Array, " params"]:
        """The values that the priors are for; 0 for directions and points, of which nothing is known beforehand."""

    @abc.abstractmethod
    def departure(self, other: "AbstractMotion") -> Float[np.ndarray, " params"]:
        """How far another motion of the same kind is away, in the minimal coordinates of this one."""

    @abc.abstractmethod
    def pointed(self, up: Float[Array, "3"]) -> "AbstractMotion":
        """The same motion in its canonical form, for an image whose up side is `up` in the camera frame."""

    @abc.abstractmethod
    def carrying(self, carries: Carries) -> "AbstractMotion":
        """The same motion of boards in front of the camera, described for the other part where it can be."""
