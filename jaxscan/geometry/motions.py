"""Motions of a scanner between its records: a turntable, a linear stage, or none."""

import abc
from collections.abc import Sequence
from typing import ClassVar, Literal

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry.arrays import Array, ArrayModule, namespace, real
from jaxscan.geometry.parameters import ParameterBlock
from jaxscan.geometry.rigid import move_direction, nearest_rotation, rigid, tangent_basis, turn, unit_vector


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
        """Difference of another motion of the same kind, in the minimal coordinates of this one."""

    @abc.abstractmethod
    def pointed(self, up: Float[Array, "3"]) -> "AbstractMotion":
        """The same motion in its canonical form, for an image whose up side is `up` in the camera frame."""

    @abc.abstractmethod
    def carrying(self, carries: Carries) -> "AbstractMotion":
        """The same motion of boards in front of the camera, described for the other part where it can be."""


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
        """Return this motion: there is nothing to move."""
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
        """Difference of another stage, in the minimal coordinates of this one."""
        if not isinstance(other, LinearStage):
            raise TypeError(f"found {type(other).__name__}, expected a linear stage")
        return np.append(self.basis @ (other.direction - self.direction), other.gain - self.gain)

    def pointed(self, up: Float[Array, "3"]) -> "LinearStage":
        """The same: its direction is that of larger positions, whichever way is up."""
        return self

    def carrying(self, carries: Carries) -> "LinearStage":
        """The same: nobody can see which part moves."""
        return self


Turns = Literal["scanner", "object"]

_ANGLE = (
    # The prior is for |gain|: the accuracy of the table's gears and step count.
    ParameterBlock("gain", ("gain",), 0.001, prior="gain", sigma=1e-3, expected=1.0),
    ParameterBlock("harmonics", ("c1", "s1", "c2", "s2"), 0.001, "rad", prior="harmonics", sigma=3e-4),
)
ANGLE_PARAMETERS = tuple(name for block in _ANGLE for name in block.parameters)
"""Names of the coordinates of the angle about the axis."""


class Turntable(AbstractMotion):
    r"""Motion $\exp(\theta(\varphi)\,\xi)$ about the axis through `point` along `direction`.

    $$\theta(\varphi) = \mathrm{gain}\,\varphi
      + \sum_{h=1,2} [c_h (\cos h\varphi - 1) + s_h \sin h\varphi]$$

    with $\varphi$ [rad] the table's own angle from home, so $\theta(0) = 0$.
    """

    direction: Float[Array, "3"] = eqx.field(converter=real)
    """Unit direction a of the axis, camera frame at angle 0, on the image's up side."""
    point: Float[Array, "3"] = eqx.field(converter=real)
    """Point p of the axis nearest the camera centre [m], camera frame at angle 0; a . p = 0."""
    gain: Float[Array, ""] = eqx.field(converter=real)
    """Turned angle per commanded angle [1], about +1 or -1; the sign is the table's sense."""
    harmonics: Float[Array, "4"] = eqx.field(converter=real)
    """c1, s1, c2, s2 [rad]."""
    basis: Float[Array, "2 3"] = eqx.field(converter=real)
    """Tangent vectors of the minimal coordinates d1, d2 (and p1, p2)."""
    carries: Turns = eqx.field(static=True, default="scanner")
    """Whether the scanner turns, or the object in front of a fixed scanner."""

    blocks: ClassVar[tuple[ParameterBlock, ...]] = (
        ParameterBlock("axis", ("axis.d1", "axis.d2", "axis.p1", "axis.p2"), 0.01, "rad, m"),
        *_ANGLE,
    )

    @staticmethod
    def from_axis(
        direction: ArrayLike | Sequence[float],
        point: ArrayLike | Sequence[float],
        *,
        gain: float = 1.0,
        carries: Turns = "scanner",
    ) -> "Turntable":
        """An axis through any of its points, camera frame at angle 0.

        Args:
            direction: Three numbers, of any length. The table turns right-handed about it where `gain` is positive.
            point: Any point of the axis [m].
            gain: Turned angle per commanded angle [1].
            carries: Whether the scanner or the object turns.

        Raises:
            ValueError: If the direction is zero, the point is not finite, or the gain is 0.
        """
        a, _ = unit_vector(direction, "direction")
        p = np.asarray(point, np.float64)
        if p.shape != (3,) or not np.isfinite(p).all():
            raise ValueError(f"point: found {p.tolist()}, expected three finite numbers")
        if gain == 0 or not np.isfinite(gain):
            raise ValueError(f"gain: found {gain:g}, expected about 1 or -1: with 0 the table does not turn")
        return Turntable(a, p - (a @ p) * a, np.asarray(float(gain)), np.zeros(4), tangent_basis(a), carries)

    @staticmethod
    def from_tr(tr: Float[Array, "4 4"]) -> "Turntable":
        """The axis of the paper's Tr, the motion of the camera in one step [m].

        Tr is a fitted rigid motion; its shift along the axis is dropped. Its rotation is first
        made orthonormal. Source: the paper, equations (10)-(12).

        Raises:
            ValueError: If Tr does not turn.
        """
        tr = np.asarray(tr, np.float64)
        rotation = nearest_rotation(tr[:3, :3])
        axis = np.array(
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
        )
        if np.linalg.norm(axis) < 1e-12:
            raise ValueError("Tr is not a turn: its rotation is the identity.")
        axis = axis / np.linalg.norm(axis)
        shift = tr[:3, 3] - (axis @ tr[:3, 3]) * axis
        # (I - R) p = t has rank 2; the least-norm solution is the point nearest the camera.
        point = np.linalg.lstsq(np.eye(3) - rotation, shift, rcond=1e-9)[0]
        return Turntable.from_axis(axis, point)

    def angle(self, phi: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Turned angle theta [rad] at the table's angle `phi` [rad from home]."""
        xp = namespace(self, phi)
        c1, s1, c2, s2 = (self.harmonics[i] for i in range(4))
        first = c1 * (xp.cos(phi) - 1.0) + s1 * xp.sin(phi)
        second = c2 * (xp.cos(2.0 * phi) - 1.0) + s2 * xp.sin(2.0 * phi)
        return xp.asarray(self.gain * phi + first + second)

    def twist(self) -> Float[Array, "6"]:
        """Unit twist (v, omega) = (p x a, a)."""
        xp = namespace(self)
        return xp.concatenate([xp.cross(self.point, self.direction), self.direction])

    def motion(self, phi: Float[Array, "*n"]) -> Float[Array, "*n 4 4"]:
        """T_cam0_cam(phi): from camera coordinates at table angle `phi` [rad] to those at angle 0.

        The exponential of the angle times the axis' unit twist, in closed form. Where the table carries the object, the
        camera frame at angle 0 is the frame of the object, and the same chain runs with -theta.
        """
        xp, theta = namespace(self, phi), self.angle(phi)
        theta = theta if self.carries == "scanner" else -theta
        sin, half = xp.sin(theta), xp.sin(theta / 2)
        # 1 - cos, exact for small angles too.
        rest = 2 * half * half
        a, p = ([part[k] for k in range(3)] for part in (self.direction, self.point))
        along = sum(a[k] * p[k] for k in range(3))
        cross = [a[1] * p[2] - a[2] * p[1], a[2] * p[0] - a[0] * p[2], a[0] * p[1] - a[1] * p[0]]
        one = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        skew = [[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]]
        turned = lambda i, k: one[i][k] + rest * (a[i] * a[k] - one[i][k]) + sin * skew[i][k]
        rotation = xp.stack([xp.stack([turned(i, k) for k in range(3)], -1) for i in range(3)], -2)
        return rigid(rotation, xp.stack([rest * (p[k] - along * a[k]) - sin * cross[k] for k in range(3)], -1))

    def tr(self, step: float) -> Float[Array, "4 4"]:
        """The paper's Tr for steps of `step` [rad]. Source: the paper, equation (10)."""
        return self.motion(namespace(self).asarray(step, self.gain.dtype))

    def table(self, step: float, count: int) -> Float[Array, "count 4 4"]:
        """The paper's look-up table: the motion at angles 0, step, 2 step, ... [rad].

        Equal to the powers of `tr(step)` where the harmonics are zero. Source: the paper,
        equations (11), (12).
        """
        return self.motion(step * namespace(self).arange(count, dtype=self.gain.dtype))

    def retract(self, step: Float[Array, "9"]) -> "Turntable":
        """Moved by d1, d2 [rad], p1, p2 [m], gain, c1, s1, c2, s2 [rad]."""
        direction, basis = move_direction(self.direction, self.basis, step[:2])
        point = self.point + step[2] * self.basis[0] + step[3] * self.basis[1]
        point = point - (point * direction).sum() * direction
        return Turntable(direction, point, self.gain + step[4], self.harmonics + step[5:9], basis, self.carries)

    def frame(self) -> Float[Array, "4 4"]:
        """T_scanner_cam at angle 0.

        Origin at the point of the axis nearest the camera, z along the axis, x along the part
        of the camera's z that is perpendicular to the axis.
        """
        xp, z = namespace(self), self.direction
        x = xp.asarray([0.0, 0.0, 1.0], z.dtype) - z[2] * z
        x = x / xp.sqrt((x * x).sum())
        rotation = xp.stack([x, xp.cross(z, x), z])
        return rigid(rotation, -turn(rotation, self.point))

    def prior_values(self) -> Float[Array, "9"]:
        """The values that the priors are for: those of the angle, with the size of the gain."""
        xp = namespace(self)
        return xp.pad(xp.append(xp.abs(self.gain), self.harmonics), (4, 0))

    def departure(self, other: AbstractMotion) -> Float[np.ndarray, "9"]:
        """Difference of another table, in the minimal coordinates of this one."""
        if not isinstance(other, Turntable):
            raise TypeError(f"found {type(other).__name__}, expected a turntable")
        axis = [self.basis @ (other.direction - self.direction), self.basis @ (other.point - self.point)]
        return np.concatenate([*axis, [other.gain - self.gain], other.harmonics - self.harmonics])

    def pointed(self, up: Float[Array, "3"]) -> "Turntable":
        """The same axis and motion with the axis on the image's up side.

        Flipping the axis changes the sign of every angle, and so of gain and harmonics.
        """
        if np.dot(self.direction, up) >= 0:
            return self
        basis = np.asarray(self.basis)
        return Turntable(-self.direction, self.point, -self.gain, -self.harmonics, basis, self.carries)

    def carrying(self, carries: Carries) -> "Turntable":
        """The same motion of boards in front of the camera: a table that turns backwards turns the other part.

        Raises:
            ValueError: If neither part of a turntable is named.
        """
        if carries == self.carries:
            return self
        if carries not in ("scanner", "object"):
            raise ValueError(f"carries: found {carries}, a turntable carries the scanner or the object")
        return Turntable(self.direction, self.point, -self.gain, -self.harmonics, self.basis, carries)


MOTION_BLOCKS = tuple(dict.fromkeys(Turntable.blocks + LinearStage.blocks))
"""Blocks that any motion has."""
