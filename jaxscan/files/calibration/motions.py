"""The motion of a scanner in a calibration file: an axis, or a direction of travel."""

import dataclasses
from typing import Annotated, Any, Literal

import numpy as np
import pydantic

from jaxscan.files.calibration.numbers import UNIT_TOLERANCE, Basis, Bend, Limited, Triple, arrays, check_frame
from jaxscan.files.disk import FileModel
from jaxscan.geometry import AbstractMotion, LinearStage, Turntable
from jaxscan.geometry.motions import Turns


SLOWEST = 1e-6  # The least gain.


class TurntableTable(FileModel):
    """The axis in the camera frame at angle 0, and the model of the angle.

    With a `basis` it is canonical: a unit direction on the image's up side, and the axis point nearest the camera.
    Without one it was written by hand: any point of the axis, and a direction of any length and either sense.
    """

    carries: Turns = "scanner"
    direction: Triple
    point_m: Triple
    gain: Limited = 1.0
    """Turned angle, right-handed about `direction`, per angle of the table."""
    harmonics: tuple[Bend, Bend, Bend, Bend] = (0.0, 0.0, 0.0, 0.0)
    basis: Basis | None = None

    @pydantic.model_validator(mode="after")
    def _meaningful(self) -> "TurntableTable":
        self.motion()
        return self

    def motion(self) -> Turntable:
        """The turntable of the geometry, its axis in the sense that the file has.

        Raises:
            ValueError: If there is no axis, or it is not canonical beside a basis.
        """
        if abs(self.gain) < SLOWEST:
            raise ValueError(f"gain = {self.gain:g}: the table does not turn")
        harmonics = np.array(self.harmonics, np.float64)
        if self.basis is None:
            flat = Turntable.from_axis(self.direction, self.point_m, gain=self.gain, carries=self.carries)
            return dataclasses.replace(flat, harmonics=harmonics)
        check_frame("direction", self.direction, self.basis)
        along = float(np.dot(self.direction, self.point_m))
        if abs(along) > UNIT_TOLERANCE * max(1.0, float(np.linalg.norm(self.point_m))):
            raise ValueError(
                f"direction · point_m = {along:.3g}, expected 0: point_m is the axis point nearest the camera"
            )
        direction, point, gain, basis = arrays(self.direction, self.point_m, self.gain, self.basis)
        return Turntable(direction, point, gain, harmonics, basis, self.carries)


class LinearTable(FileModel):
    """The direction in which a linear stage moves the camera past the object, in the camera frame.

    With a `basis` it is canonical: a unit direction. Without one it was written by hand: of any length.
    """

    carries: Literal["linear"]
    direction: Triple
    gain: Limited = 1.0
    """Travel per commanded travel."""
    basis: Basis | None = None

    @pydantic.model_validator(mode="after")
    def _meaningful(self) -> "LinearTable":
        self.motion()
        return self

    def motion(self) -> LinearStage:
        """The linear stage of the geometry.

        Raises:
            ValueError: If there is no direction, or it is not canonical beside a basis.
        """
        if abs(self.gain) < SLOWEST or (self.gain < 0 and self.basis is not None):
            raise ValueError(f"gain = {self.gain:g}: expected about 1")
        if self.basis is None:
            return LinearStage.from_direction(self.direction, gain=self.gain)
        check_frame("direction", self.direction, self.basis)
        return LinearStage(*arrays(self.direction, self.gain, self.basis))


def _kind(value: Any) -> str:
    carries = value.get("carries") if isinstance(value, dict) else getattr(value, "carries", None)
    return "a line" if carries == "linear" else "an axis"


MotionTable = Annotated[
    Annotated[TurntableTable, pydantic.Tag("an axis")] | Annotated[LinearTable, pydantic.Tag("a line")],
    pydantic.Discriminator(_kind),
]
"""The table of any motion."""


def motion_table(motion: AbstractMotion) -> dict[str, Any] | None:
    """A motion as its table in the file; None for a scanner that stands still."""
    if isinstance(motion, LinearStage):
        return {"carries": "linear", **{name: getattr(motion, name) for name in ("direction", "gain", "basis")}}
    if not isinstance(motion, Turntable):
        return None
    return {
        "carries": motion.carries,
        "direction": motion.direction,
        "point_m": motion.point,
        "gain": motion.gain,
        "harmonics": motion.harmonics,
        "basis": motion.basis,
    }
