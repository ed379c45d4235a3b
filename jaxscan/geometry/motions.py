"""Motions of a scanner between its records: a turntable, a linear stage, or none.

A motion is a class here and a row of `motion_kinds.py`; all other rooms work by these two.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry.arrays import Array, ArrayModule, namespace, real
from jaxscan.geometry.fit import fit_axis
from jaxscan.geometry.motion_kinds import MOTIONS
from jaxscan.geometry.parameters import ParameterBlock
from jaxscan.geometry.rigid import (
    check_frame,
    compose,
    exponential,
    invert,
    move_direction,
    nearest_rotation,
    rigid,
    rotation_vectors,
    tangent_basis,
    turn,
    unit_vector,
)


SLOWEST = 1e-6  # The least gain.
# Ratio of the boards' motion to the commanded one, within which the command is accepted.
_GAINS = (0.8, 1.25)
# Boards in front of a linear stage do not turn; poses from a first camera may be off by up to this.
_MAX_TILT_DEG = 5.0
# Turns of the hand about a second direction that suffice to find the place of its camera [rad].
_LEAST_TURN = 0.03
_UNMOVED = "that records with the same `placement` saw the board unmoved"


class Field(NamedTuple):
    """Numbers in the table of a motion in files."""

    shape: tuple[int, ...]
    default: Any = ...
    """The numbers where the file has none; without a default they are required."""


_GAIN = Field((), 1.0)
_BASIS = Field((2, 3), None)
"""With a basis a table is canonical; without one it was written by hand, and vectors are of any length."""


class Described(NamedTuple):
    """A line of a report."""

    name: str
    values: tuple[float, ...]
    sigma: float
    unit: str
    """Unit of values and sigma; "direction" for a unit vector, whose sigma is in mrad."""


class AbstractMotion(ArrayModule):
    """A motion with one position s per record: the table's angle [rad], or the place of a stage [m].

    At position 0 the camera is where it defines the rig.
    """

    blocks: eqx.AbstractClassVar[tuple[ParameterBlock, ...]]
    """Blocks of its minimal coordinates, in the order of `retract`."""
    fields: eqx.AbstractClassVar[Mapping[str, Field]]
    """Its table in files: the attributes by name, with their unit where that is not 1."""

    @property
    @abc.abstractmethod
    def carries(self) -> str:
        """Its name in `MOTIONS`."""

    @staticmethod
    @abc.abstractmethod
    def of_table(values: Mapping[str, Any], carries: str) -> "AbstractMotion":
        """The motion of the numbers of a file.

        Raises:
            ValueError: If they make no motion.
        """

    @staticmethod
    @abc.abstractmethod
    def of_boards(poses: Float[np.ndarray, "2 pairs 4 4"], change: Float[np.ndarray, "pairs ..."]) -> "AbstractMotion":
        """First values, from T_cam_board of boards that stood still at two positions, and the second less the first.

        Of given poses `change` is T_first_second of the hand [pairs, 4, 4].

        Raises:
            ValueError: If boards do not move so, with the finding and the remedy.
        """

    @abc.abstractmethod
    def described(self, sigma: Mapping[str, float]) -> list[Described]:
        """Lines of a report, with the standard deviations of the minimal coordinates by name."""

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
    def departure(self, other: Any) -> Float[np.ndarray, " params"]:
        """Difference of another motion of the same kind, in the minimal coordinates of this one."""

    def along(self, path: Float[np.ndarray, "records 4 4"] | None) -> "AbstractMotion":
        """The motion in one capture, where its records have poses: a `Hand`'s."""
        return self

    def table(self) -> dict[str, Any]:
        """Its numbers in files; see `fields`."""
        return {"carries": self.carries, **{key: getattr(self, key.removesuffix("_m")) for key in self.fields}}


class Still(AbstractMotion):
    """The camera stays where it is; the scanner frame is the camera frame."""

    blocks: ClassVar[tuple[ParameterBlock, ...]] = ()
    fields: ClassVar[Mapping[str, Field]] = {}

    @property
    def carries(self) -> str:
        return "nothing"

    @staticmethod
    def of_table(values: Mapping[str, Any], carries: str) -> "Still":
        return Still()

    @staticmethod
    def of_boards(poses: Float[np.ndarray, "2 pairs 4 4"], change: Float[np.ndarray, " pairs"]) -> "Still":
        return Still()

    def described(self, sigma: Mapping[str, float]) -> list[Described]:
        return []

    def motion(self, s: Float[Array, "*n"]) -> Float[Array, "*n 4 4"]:
        xp = namespace(s)
        return xp.broadcast_to(xp.eye(4, dtype=s.dtype), (*s.shape, 4, 4))

    def twist(self) -> Float[Array, "6"]:
        return np.zeros(6)

    def frame(self) -> Float[Array, "4 4"]:
        return np.eye(4, dtype=np.float32)

    def retract(self, step: Float[Array, " params"]) -> "Still":
        return self

    def prior_values(self) -> Float[Array, " params"]:
        return np.zeros(0)

    def departure(self, other: Any) -> Float[np.ndarray, " params"]:
        return np.zeros(0)


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
    fields: ClassVar[Mapping[str, Field]] = {"direction": Field((3,)), "gain": _GAIN, "basis": _BASIS}

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
    def carries(self) -> str:
        return "linear"

    @staticmethod
    def of_table(values: Mapping[str, Any], carries: str) -> "LinearStage":
        direction, gain, basis = (values[key] for key in LinearStage.fields)
        if abs(gain) < SLOWEST or (gain < 0 and basis is not None):
            raise ValueError(f"gain = {gain:g}: expected about 1")
        if basis is None:
            return LinearStage.from_direction(direction, gain=float(gain))
        check_frame("direction", direction, basis)
        return LinearStage(direction, gain, basis)

    @staticmethod
    def of_boards(poses: Float[np.ndarray, "2 pairs 4 4"], change: Float[np.ndarray, " pairs"]) -> "LinearStage":
        """Direction of travel, as the mean of the boards' shifts over the commanded ones."""
        before, after = poses
        turned = np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
        tilt = np.degrees(np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1.0, 1.0)))
        if np.median(tilt) > _MAX_TILT_DEG:
            raise ValueError(
                f"The boards turned by {np.median(tilt):.1f} degrees while the stage moved, and a linear stage only "
                f"shifts them: check `carries` in capture.toml, and {_UNMOVED}."
            )
        # The camera goes the other way than boards in front of it.
        direction = change @ (before[:, :3, 3] - after[:, :3, 3]) / (change @ change)
        gain = float(np.linalg.norm(direction))
        if not _GAINS[0] < gain < _GAINS[1]:
            raise ValueError(
                f"The boards moved by {gain:.3f} times the commanded travel: check that position_m is in metres, the "
                f"size of the board's squares, and {_UNMOVED}."
            )
        return LinearStage.from_direction(direction)

    def described(self, sigma: Mapping[str, float]) -> list[Described]:
        tilt = 1e3 * float(np.hypot(sigma.get("travel.t1", 0.0), sigma.get("travel.t2", 0.0)))
        return [
            Described("travel: direction", _numbers(self.direction), tilt, "direction"),
            Described("gain of the travel", (float(self.gain),), sigma.get("gain", 0.0), ""),
        ]

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

    def departure(self, other: Any) -> Float[np.ndarray, "3"]:
        return np.append(self.basis @ (other.direction - self.direction), other.gain - self.gain)


class Hand(AbstractMotion):
    r"""The camera rides on a hand whose pose is given for every record: $T_\mathrm{base,hand}(s)\,T_\mathrm{hand,cam}$.

    A position s is the number of a record; the poses are the capture's (`along`). The scanner frame is the base of the
    robot, or the frame of the tracker; at "position 0" of the other motions the hand would be there.
    """

    hand_cam: Float[Array, "4 4"] = eqx.field(converter=real)
    """T_hand_cam [m]."""
    scatter: Float[Array, "2"] = eqx.field(converter=real)
    """Standard deviations of the given poses, of each coordinate, by place [m] and by angle [rad]."""
    path: Float[Array, "records 4 4"] = eqx.field(converter=real)
    """T_base_hand of every record [m]."""

    blocks: ClassVar[tuple[ParameterBlock, ...]] = (
        ParameterBlock("hand", tuple(f"hand.{name}" for name in ("t1", "t2", "t3", "r1", "r2", "r3")), 0.01, "m, rad"),
    )
    fields: ClassVar[Mapping[str, Field]] = {
        "translation_m": Field((3,)),
        "rotation": Field((3,)),
        "sigma_position_m": Field((), 0.0),
        "sigma_rotation": Field((), 0.0),
    }

    @staticmethod
    def mounted(hand_cam: Float[np.ndarray, "4 4"], scatter: tuple[float, float] = (0.0, 0.0)) -> "Hand":
        """A camera at T_hand_cam; the poses of records are still to come."""
        return Hand(hand_cam, np.array(scatter), np.eye(4)[None])

    @property
    def carries(self) -> str:
        return "poses"

    @staticmethod
    def of_table(values: Mapping[str, Any], carries: str) -> "Hand":
        translation, vector, place, angle = (values[key] for key in Hand.fields)
        if not (0 <= place < 1 and 0 <= angle < 1):
            raise ValueError(f"sigma_position_m, sigma_rotation: found {place:g}, {angle:g}, expected 0 to 1 m or rad")
        hand_cam = np.array(exponential(np.concatenate([np.zeros(3), np.asarray(vector, np.float64)])))
        hand_cam[:3, 3] = translation
        return Hand.mounted(hand_cam, (float(place), float(angle)))

    @staticmethod
    def of_boards(poses: Float[np.ndarray, "2 pairs 4 4"], change: Float[np.ndarray, "pairs 4 4"]) -> "Hand":
        """Solve $A X = X B$ for the motions of the hand and of the camera; rotations first.

        Source: Park and Martin, Robot sensor calibration (1994), with the nearest rotation to the sum.
        """
        seen = poses[0] @ invert(poses[1])
        by_hand, by_camera = (rotation_vectors(turned) for turned in (change, seen))
        _, spread, _ = np.linalg.svd(by_camera)
        if len(by_camera) < 2 or spread[1] < _LEAST_TURN * np.sqrt(len(by_camera)):
            raise ValueError(
                "The hand turned about one direction alone, if at all, which does not tell where the camera sits on "
                f"it: turn it by 20 degrees and more about two axes between pictures of the board, and see {_UNMOVED}."
            )
        rotation = nearest_rotation(by_hand.T @ by_camera)
        left = (change[:, :3, :3] - np.eye(3)).reshape(-1, 3)
        right = (seen[:, :3, 3] @ rotation.T - change[:, :3, 3]).ravel()
        return Hand.mounted(np.asarray(rigid(rotation, np.linalg.lstsq(left, right, rcond=None)[0])))

    def along(self, path: Float[np.ndarray, "records 4 4"] | None) -> "Hand":
        """The same hand with the poses of a capture's records, T_base_hand."""
        return self if path is None else Hand(self.hand_cam, self.scatter, path)

    def described(self, sigma: Mapping[str, float]) -> list[Described]:
        size = lambda part: float(np.linalg.norm([sigma.get(f"hand.{part}{k}", 0.0) for k in (1, 2, 3)]))
        vector = rotation_vectors(np.asarray(self.hand_cam, np.float64)[None])[0]
        return [
            Described("camera on the hand: place", _numbers(self.hand_cam[:3, 3]), size("t"), "m"),
            Described("camera on the hand: rotation vector", _numbers(vector), size("r"), "rad"),
            Described("scatter of the hand's poses: place", (float(self.scatter[0]),), 0.0, "m"),
            Described("scatter of the hand's poses: angle", (float(self.scatter[1]),), 0.0, "rad"),
        ]

    def motion(self, s: Float[Array, "*n"]) -> Float[Array, "*n 4 4"]:
        xp = namespace(self, s)
        given = xp.asarray(self.path)[xp.round(s).astype(xp.int32)]
        return compose(invert(xp.asarray(self.hand_cam)), compose(given, xp.asarray(self.hand_cam)))

    def twist(self) -> Float[Array, "6"]:
        # Nothing lies between two poses.
        return np.zeros(6)

    def frame(self) -> Float[Array, "4 4"]:
        return self.hand_cam

    def retract(self, step: Float[Array, "6"]) -> "Hand":
        """Moved by a twist in the camera's frame [m, rad]."""
        return Hand(compose(self.hand_cam, exponential(step)), self.scatter, self.path)

    def prior_values(self) -> Float[Array, "6"]:
        return np.zeros(6)

    def departure(self, other: Any) -> Float[np.ndarray, "6"]:
        change = np.asarray(invert(self.hand_cam) @ other.hand_cam, np.float64)
        return np.concatenate([change[:3, 3], rotation_vectors(change[None])[0]])

    def table(self) -> dict[str, Any]:
        hand_cam = np.asarray(self.hand_cam, np.float64)
        numbers = hand_cam[:3, 3], rotation_vectors(hand_cam[None])[0], *map(float, self.scatter)
        return {"carries": self.carries, **dict(zip(self.fields, numbers, strict=True))}


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
    fields: ClassVar[Mapping[str, Field]] = {
        "direction": Field((3,)),
        "point_m": Field((3,)),
        "gain": _GAIN,
        "harmonics": Field((4,), (0.0, 0.0, 0.0, 0.0)),
        "basis": _BASIS,
    }

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
    def of_table(values: Mapping[str, Any], carries: str) -> "Turntable":
        direction, point, gain, harmonics, basis = (values[key] for key in Turntable.fields)
        part: Turns = "object" if carries == "object" else "scanner"
        if abs(gain) < SLOWEST:
            raise ValueError(f"gain = {gain:g}: the table does not turn")
        if basis is None:
            return replace(
                Turntable.from_axis(direction, point, gain=float(gain), carries=part), harmonics=real(harmonics)
            )
        check_frame("direction", direction, basis)
        along = float(np.dot(direction, point))
        if abs(along) > 1e-6 * max(1.0, float(np.linalg.norm(point))):
            raise ValueError(
                f"direction · point_m = {along:.3g}, expected 0: point_m is the axis point nearest the camera"
            )
        return Turntable(direction, point, gain, harmonics, basis, part)

    @staticmethod
    def of_boards(poses: Float[np.ndarray, "2 pairs 4 4"], change: Float[np.ndarray, " pairs"]) -> "Turntable":
        """Axis and sense of the table. Source: the paper, equation (10), for all pairs of angles."""
        # The camera turns, so boards turn the other way.
        moved = poses[1] @ np.linalg.inv(poses[0])
        try:
            axis = fit_axis(moved)
        except ValueError:
            raise ValueError(
                f"The commanded angles differ by up to {np.degrees(np.abs(change).max()):.1f} degrees but the board "
                "did not move in the image: the table did not turn, or the board turned with the camera."
            ) from None
        gain = _gain(-change, _signed_angles(moved[:, :3, :3], axis.direction))
        if not _GAINS[0] < abs(gain) < _GAINS[1]:
            raise ValueError(
                f"The boards turned by {gain:.3f} times the commanded angles: check the steps per turn of the table, "
                f"and {_UNMOVED}."
            )
        return Turntable.from_axis(axis.direction, axis.point, gain=float(np.sign(gain)))

    def described(self, sigma: Mapping[str, float]) -> list[Described]:
        of = lambda name: sigma.get(name, 0.0)
        tilt, shift = (1e3 * float(np.hypot(of(f"axis.{part}1"), of(f"axis.{part}2"))) for part in "dp")
        errors = zip(ANGLE_PARAMETERS[1:], 1e3 * np.asarray(self.harmonics), strict=True)
        return [
            Described("axis: direction", _numbers(self.direction), tilt, "direction"),
            Described("axis: nearest point", _numbers(1e3 * np.asarray(self.point)), shift, "mm"),
            Described("gain of the angle", (float(self.gain),), of("gain"), ""),
            *(
                Described(f"angle error {name}", (float(value),), 1e3 * of(name), "mrad")
                for name, value in errors
                if of(name) > 0
            ),
        ]

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

    def departure(self, other: Any) -> Float[np.ndarray, "9"]:
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

    def carrying(self, carries: str) -> "Turntable":
        """The same motion of boards in front of the camera: a table that turns backwards turns the other part.

        Raises:
            ValueError: If neither part of a turntable is named.
        """
        if carries == self.carries:
            return self
        if carries not in ("scanner", "object"):
            raise ValueError(f"carries: found {carries}, a turntable carries the scanner or the object")
        part: Turns = "object" if carries == "object" else "scanner"
        return Turntable(self.direction, self.point, -self.gain, -self.harmonics, self.basis, part)


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(np.asarray(values, np.float64).tolist())


def _signed_angles(rotations: np.ndarray, direction: np.ndarray) -> np.ndarray:
    skew = rotations - np.swapaxes(rotations, 1, 2)
    vector = np.column_stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]]) / 2
    return np.arctan2(vector @ direction, (np.trace(rotations, axis1=1, axis2=2) - 1) / 2)


def _gain(commanded: np.ndarray, seen: np.ndarray) -> float:
    """Seen over commanded angle, whichever sense fits; `seen` is known up to full turns."""
    best, error = 0.0, np.inf
    for sense in (1.0, -1.0):
        full = seen + 2 * np.pi * np.round((sense * commanded - seen) / (2 * np.pi))
        gain = float(commanded @ full / (commanded @ commanded))
        misfit = float(np.abs(full - gain * commanded).mean() + np.abs(full - sense * commanded).mean())
        if misfit < error:
            best, error = gain, misfit
    return best


def motion_class(carries: str) -> type[AbstractMotion]:
    """The class of a kind of motion."""
    found: type[AbstractMotion] = globals()[MOTIONS[carries].motion]
    return found


def motion_of(carries: str, **values: Any) -> AbstractMotion:
    """The motion of some numbers of its table in files; the others are as if a person had left them out.

    Raises:
        ValueError: If they make no motion.
    """
    kind = motion_class(carries)
    return kind.of_table({key: values.get(key, field.default) for key, field in kind.fields.items()}, carries)


def carrying(motion: AbstractMotion, carries: str) -> AbstractMotion:
    """The same motion of boards in front of the camera; that of a turntable described for the part that it carries."""
    return motion.carrying(carries) if isinstance(motion, Turntable) else motion


MOTION_BLOCKS = tuple(dict.fromkeys(block for carries in MOTIONS for block in motion_class(carries).blocks))
"""Blocks that any motion has."""
