"""A rig's configuration: which controller, table, laser and camera there are, and what is to be captured."""

import hashlib
import json
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from jaxscan.files.capture import BoardTable, LaserTable
from jaxscan.files.disk import FileModel, Integer, Number, load_toml
from jaxscan.geometry.turntable import Carries
from jaxscan.stripes import LaserLine
from scanrig.cameras import CameraSettings
from scanrig.checks import ProofLimits
from scanrig.controllers import ControllerTable


MAX_MICROSTEPS = 10_000_000
"""Largest number of microsteps of a turn: an hour at the fastest a controller steps is half of this."""
MAX_LASERS = 2
"""Lasers that a controller can switch."""

_Milliseconds = Annotated[Integer, pydantic.Field(ge=0, le=10_000)]
_Angle = Annotated[Number, pydantic.Field(ge=-360, le=360)]
_Limit = Annotated[Number, pydantic.Field(ge=-3600, le=3600)]
_Count = Annotated[Integer, pydantic.Field(ge=1, le=100_000)]


_RATES = {
    "speed_deg_s": (50.0, 50, 10_000),
    "start_speed_deg_s": (5.0, 20, 10_000),
    "acceleration_deg_s2": (100.0, 100, 60_000),
    "home_speed_deg_s": (2.5, 20, 10_000),
}
"""Key: a moderate value, and what the controller takes in microsteps."""


class TurntableTable(FileModel):
    """What turns, and how. Speeds that are not given are moderate ones."""

    carries: Carries = "scanner"
    full_steps: Annotated[Integer, pydantic.Field(ge=4, le=100_000)] = 200
    """Full steps of the motor in a turn of the motor."""
    microsteps: Annotated[Integer, pydantic.Field(ge=1, le=1024)] = 16
    """Microsteps in a full step, as the driver is set."""
    gear: tuple[Integer, Integer] = (1, 1)
    """Turns of the motor in a turn of the table, as two integers: [9, 1], or [60, 16] teeth."""
    speed_deg_s: Annotated[Number, pydantic.Field(gt=0, le=1000)] | None = None
    start_speed_deg_s: Annotated[Number, pydantic.Field(gt=0, le=1000)] | None = None
    """Speed at which a ramp may begin."""
    acceleration_deg_s2: Annotated[Number, pydantic.Field(gt=0, le=10_000)] | None = None
    home_speed_deg_s: Annotated[Number, pydantic.Field(gt=0, le=1000)] | None = None
    """Speed of the slow approach to the home switch."""
    home_within_deg: Annotated[Number, pydantic.Field(gt=0, le=800)] = 400.0
    """How far the home switch is looked for."""
    backlash_deg: Annotated[Number, pydantic.Field(ge=0, le=30)] = 0.0
    """How far beyond a target a downward motion goes first, so that all arrive from the same side."""
    limits_deg: tuple[_Limit, _Limit] | None = None
    """Angles that the table may not leave: cables."""
    settle_ms: _Milliseconds = 50
    """Rest before a shot."""
    reverse: bool = False
    """Turns the sense round."""

    @pydantic.model_validator(mode="after")
    def _whole(self) -> "TurntableTable":
        if min(self.gear) < 1 or max(self.gear) > 100_000:
            raise ValueError(f"gear: found {list(self.gear)}, expected two integers of 1 ... 100000")
        turn = Fraction(self.full_steps * self.microsteps * self.gear[0], self.gear[1])
        if turn.denominator != 1:
            raise ValueError(
                f"gear: {self.full_steps} full steps x {self.microsteps} microsteps x {self.gear[0]}/{self.gear[1]} = "
                f"{float(turn):.3f} microsteps per turn, expected a whole number"
            )
        if not 8 <= turn <= MAX_MICROSTEPS:
            raise ValueError(f"found {turn} microsteps per turn, expected 8 ... {MAX_MICROSTEPS}")
        if self.limits_deg is not None and not self.limits_deg[0] <= 0 <= self.limits_deg[1]:
            raise ValueError(f"limits_deg: found {list(self.limits_deg)}, expected [low, high] with home, 0, within")
        for name in _RATES:
            self.rate(name)
        if self.rate("start_speed_deg_s") > self.rate("speed_deg_s"):
            raise ValueError("start_speed_deg_s: found more than speed_deg_s, expected at most as much")
        return self

    def rate(self, name: str) -> int:
        """A speed or acceleration as the controller takes it.

        Args:
            name: Its key.

        Returns:
            Microsteps per second, or per second squared.

        Raises:
            ValueError: If the controller cannot do that.
        """
        moderate, low, high = _RATES[name]
        given = getattr(self, name)
        found = round((moderate if given is None else given) * self.microsteps_per_turn / 360)
        if given is not None and not low <= found <= high:
            turn = self.microsteps_per_turn
            raise ValueError(
                f"{name}: found {given:g}, which is {found} microsteps with {turn} in a turn; "
                f"expected {low} ... {high}, so {low * 360 / turn:.3g} ... {high * 360 / turn:.4g}"
            )
        return min(max(found, low), high)

    @property
    def microsteps_per_turn(self) -> int:
        """Microsteps in a turn of the table."""
        return self.full_steps * self.microsteps * self.gear[0] // self.gear[1]


class RigLaser(LaserTable):
    """The laser as the camera sees it, and how long it takes to switch."""

    on_ms: _Milliseconds = 20
    """From switching on to the exposure."""
    off_ms: _Milliseconds = 20
    """From switching off to the exposure: also the time the camera needs to read a frame out."""

    @property
    def line(self) -> LaserLine:
        """It as the stripe extraction takes it."""
        return LaserLine(self.name, self.colour, self.stripe_axis)

    @property
    def table(self) -> LaserTable:
        """It as a capture's header has it."""
        return LaserTable(name=self.name, colour=self.colour, stripe_axis=self.stripe_axis)


class TriggerTable(FileModel):
    """The wire from the controller to the camera."""

    pulse_ms: Annotated[Integer, pydantic.Field(ge=1, le=5000)] | None = None
    """Length of a trigger pulse; by default that of the exposure, rounded up."""
    gap_ms: _Milliseconds = 5
    """After each exposure."""
    ready_ms: _Milliseconds = 0
    """Longest wait for the camera's ready output before each trigger; 0 where it is not wired."""


class SweepTable(FileModel):
    """Which angles a sweep has."""

    steps: _Count = 3600
    """Steps of a pass."""
    turn_deg: _Angle = 360.0
    """Angle of a pass; the last step stands one step before its end. Negative: downwards."""
    start_deg: _Angle = 0.0
    turns: Annotated[Integer, pydantic.Field(ge=1, le=1000)] = 1
    """Passes; the table goes home after each, so that no cable winds up."""

    @pydantic.model_validator(mode="after")
    def _turns(self) -> "SweepTable":
        if self.turn_deg == 0:
            raise ValueError("turn_deg: found 0, expected an angle")
        return self


class CalibrationTable(FileModel):
    """How many views of the board a calibration has."""

    free_views: Annotated[Integer, pydantic.Field(ge=0, le=1000)] = 24
    """Views from the home angle, the board held differently in each."""
    placements: Annotated[Integer, pydantic.Field(ge=0, le=100)] = 4
    """Places where the board stands still while the table turns."""
    angles_deg: Annotated[tuple[_Angle, ...], pydantic.Field(min_length=2, max_length=1000)] = (
        -15.0,
        -10.0,
        -5.0,
        0.0,
        5.0,
        10.0,
        15.0,
    )
    """Angles of the table for each placement."""


class ChecksTable(FileModel):
    """When a pair, a step or a turn is believed. Changing this does not forbid resuming."""

    proof: ProofLimits = ProofLimits()
    """Limits of the proof of every pair."""
    retakes: Annotated[Integer, pydantic.Field(ge=0, le=100)] = 3
    """Times that a step is taken again before the scan ends."""
    late_s: Annotated[Number, pydantic.Field(gt=0, le=60)] = 2.0
    """How long after its exposure a frame may come; waited for only where one is missing [s]."""
    lost_steps_tolerance: Annotated[Integer, pydantic.Field(ge=0, le=100_000)] = 2
    """Microsteps by which home may be missed before the steps since the last good one are suspect."""
    shift_px: Annotated[Number, pydantic.Field(gt=0, le=1000)] = 1.0
    """How far the line may have moved where a step is taken again and compared."""
    correlation: Annotated[Number, pydantic.Field(gt=0, lt=1)] = 0.75
    """Least correlation of the laser-off images' structure, 1 for the same view in any light, that such a comparison
    accepts."""
    camera_reopens: Annotated[Integer, pydantic.Field(ge=0, le=1000)] = 10
    """Times that a lost camera is opened again, with growing pauses, before the scan ends."""


class RigConfig(FileModel):
    """All of a rig's configuration file."""

    controller: ControllerTable = ControllerTable()
    turntable: TurntableTable = TurntableTable()
    laser: Annotated[tuple[RigLaser, ...], pydantic.Field(min_length=1, max_length=MAX_LASERS)] = (RigLaser(),)
    """In the order in which the controller numbers them; each step of a sweep is taken with one after the other."""
    camera: CameraSettings
    trigger: TriggerTable = TriggerTable()
    board: BoardTable | None = None
    sweep: SweepTable = SweepTable()
    calibration: CalibrationTable = CalibrationTable()
    checks: ChecksTable = ChecksTable()

    @pydantic.field_validator("laser", mode="before")
    @classmethod
    def _listed(cls, tables: Any) -> Any:
        return (
            (tables,) if isinstance(tables, dict | RigLaser) else tuple(tables) if isinstance(tables, list) else tables
        )

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> "RigConfig":
        if min(self.camera.width, self.camera.height) < 64:
            raise ValueError(
                f"camera: found {self.camera.width} x {self.camera.height} px, expected 64 px at least: "
                "a line needs sides"
            )
        names = [laser.name for laser in self.laser]
        if len(set(names)) < len(names):
            raise ValueError(f"laser: found {' and '.join(names)}, expected a different name for each")
        if self.trigger.pulse_ms is None and self.camera.exposure_ms > 5000 and self.camera.trigger == "hardware":
            raise ValueError(
                f"camera.exposure_ms: found {self.camera.exposure_ms:g}, expected at most 5000 with a trigger pulse of "
                "the exposure's length; give trigger.pulse_ms where the camera times its exposure itself"
            )
        return self

    @property
    def microsteps_per_turn(self) -> int:
        """Microsteps in a turn of the table, N."""
        return self.turntable.microsteps_per_turn

    def laser_of(self, record: int) -> int:
        """Which laser a record shows, counted from 0: they take turns."""
        return record % len(self.laser)

    def frame_tables(self, kind: Literal["sweep", "calibration"]) -> dict[str, Any]:
        """All that makes the frames of such a capture what they are, as TOML holds it.

        The port, the limits of checks and the tables of the other kind may change within a capture.
        """
        tables = self.model_dump(mode="json", exclude={"controller", "checks"}, exclude_none=True)
        for name in ("calibration", "board") if kind == "sweep" else ("sweep",):
            tables.pop(name, None)
        # Where the camera is plugged in does not matter, which one it is is told by its serial number.
        for name in ("id", "packet_size"):
            tables["camera"].pop(name, None)
        return tables

    def digest(self, kind: Literal["sweep", "calibration"]) -> str:
        """The sha256 of `frame_tables`, as "sha256:<hex>"."""
        text = json.dumps(self.frame_tables(kind), sort_keys=True, allow_nan=False)
        return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def load_rig(path: str | Path) -> RigConfig:
    """The configuration of a rig.

    Raises:
        ConfigError: One line: the file, the key, what was found and what may stand there.
    """
    return load_toml(path, RigConfig)
