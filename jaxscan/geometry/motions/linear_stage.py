"""The linear stage: scanner and object move past each other along a straight line."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry.arrays import Array, namespace, real
from jaxscan.geometry.motions.motion import AbstractMotion, Carries
from jaxscan.geometry.parameters import ParameterBlock
from jaxscan.geometry.rigid import rigid
from jaxscan.geometry.tangent import move_direction, tangent_basis, unit_vector


class LinearStage(AbstractMotion):
    r"""The camera moves by $\mathrm{gain} \cdot s$ along `direction`, seen from the object.

    A stage that carries the object past a fixed camera is the same motion: only the motion of the one against
    the other is seen.
    """

    direction: Float[Array, "3"] = eqx.field(converter=real)
    """Unit direction of the camera's travel towards larger positions, camera frame."""
    gain: Float[Array, ""] = eqx.field(converter=real)
    """Travel per commanded travel [1], about 1."""
    basis: Float[Array, "2 3"] = eqx.field(converter=real)
    """Tangent vectors of the minimal coordinates t1, t2 of the direction."""

    blocks: ClassVar[tuple[ParameterBlock, ...]] = (
        ParameterBlock("travel", ("travel.t1", "travel.t2"), 0.01, "rad"),
        # The prior is for the accuracy of the stage's screw and step count.
        ParameterBlock("gain", ("gain",), 0.001, prior="gain", sigma=1e-3, expected=1.0),
    )

    @staticmethod
    def from_direction(direction: ArrayLike | Sequence[float], *, gain: float = 1.0) -> "LinearStage":
        """A stage that moves the camera, as seen from the object, along a direction.

        Args:
            direction: Three numbers, of any length, camera frame.
            gain: Travel per commanded travel [1]; a negative one turns the direction round.

        Raises:
            ValueError: If the direction is zero, or the gain is 0.
        """
        a, _ = unit_vector(direction, "direction")
        if gain == 0 or not np.isfinite(gain):
            raise ValueError(f"gain: found {gain:g}, expected about 1: with 0 the stage does not move")
        a = np.copysign(1.0, gain) * a
        return LinearStage(a, np.asarray(abs(float(gain))), tangent_basis(a))

    @property
    def carries(self) -> Carries:
        """Its name in files."""
        return "linear"

    def motion(self, s: Float[Array, "*n"]) -> Float[Array, "*n 4 4"]:
        """T_cam0_cam(s): from camera coordinates at position `s` [m] to those at position 0."""
        xp = namespace(self, s)
        shift = xp.stack([self.gain * s * self.direction[k] for k in range(3)], -1)
        return rigid(xp.broadcast_to(xp.eye(3, dtype=shift.dtype), (*shift.shape, 3)), shift)

    def twist(self) -> Float[Array, "6"]:
        """Unit twist (v, omega) = (direction, 0)."""
        xp = namespace(self)
        return xp.concatenate([self.direction, xp.zeros_like(self.direction)])

    def frame(self) -> Float[Array, "4 4"]:
        """T_scanner_cam at position 0: the identity."""
        return namespace(self).eye(4, dtype=self.direction.dtype)

    def retract(self, step: Float[Array, "3"]) -> "LinearStage":
        """Moved by t1, t2 [rad] and gain [1]."""
        direction, basis = move_direction(self.direction, self.basis, step[:2])
        return LinearStage(direction, self.gain + step[2], basis)

    def prior_values(self) -> Float[Array, "3"]:
        """The values that the priors are for."""
        return namespace(self).pad(self.gain[None], (2, 0))

    def departure(self, other: AbstractMotion) -> Float[np.ndarray, "3"]:
        """How far another stage is away, in the minimal coordinates of this one."""
        if not isinstance(other, LinearStage):
            raise TypeError(f"found {type(other).__name__}, expected a linear stage")
        return np.append(self.basis @ (other.direction - self.direction), other.gain - self.gain)

    def pointed(self, up: Float[Array, "3"]) -> "LinearStage":
        """The same: its direction is that of larger positions, whichever way is up."""
        return self

    def carrying(self, carries: Carries) -> "LinearStage":
        """The same: nobody can see which part moves."""
        return self
