"""A rig's configuration: its controller, turntable, lasers and camera, and the plan of a capture."""

import hashlib
import json
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from jaxscan.errors import ConfigError
from jaxscan.files.capture import BoardTable, LaserTable
from jaxscan.files.disk import FileModel, Integer, Number, load_toml
from jaxscan.geometry.motions import Turns
from jaxscan.stripes import LaserLine
from scanrig.cameras import CameraSettings
from scanrig.checks import ProofLimits
from scanrig.controllers import ControllerTable


MAX_MICROSTEPS = 10_000_000
"""Most microsteps of a turn; at the highest step rate such a turn takes 17 minutes."""
MAX_LASERS = 2

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
"""Key: default, and the range that the controller takes in microsteps."""


class TurntableTable(FileModel):
    """Turntable, gear and motion. Speeds that are not given have moderate defaults."""

    carries: Turns = "scanner"
    full_steps: Annotated[Integer, pydantic.Field(ge=4, le=100_000)] = 200
    microsteps: Annotated[Integer, pydantic.Field(ge=1, le=1024)] = 16
    """Microsteps per full step, as set at the driver."""
    gear: tuple[Integer, Integer] = (1, 1)
    """Turns of the motor per turn of the table, as two integers: [9, 1], or [60, 16] teeth."""
    speed_deg_s: Annotated[Number, pydantic.Field(gt=0, le=1000)] | None = None
    start_speed_deg_s: Annotated[Number, pydantic.Field(gt=0, le=1000)] | None = None
    """Speed at the beginning of a ramp."""
    acceleration_deg_s2: Annotated[Number, pydantic.Field(gt=0, le=10_000)] | None = None
    home_speed_deg_s: Annotated[Number, pydantic.Field(gt=0, le=1000)] | None = None
    """Speed of the slow approach to the home switch."""
    home_within_deg: Annotated[Number, pydantic.Field(gt=0, le=800)] = 400.0
    """How far to search for the home switch."""
    backlash_deg: Annotated[Number, pydantic.Field(ge=0, le=30)] = 0.0
    """How far a downward motion overshoots its target, so that every target is approached from below."""
    angle_sigma_deg: Annotated[Number, pydantic.Field(ge=0, le=45)] | None = None
    """Standard deviation of where the table stops about its angles, for the headers of captures; None: not known."""
    limits_deg: tuple[_Limit, _Limit] | None = None
    """Range of angles that the table may not leave, to protect cables."""
    settle_ms: _Milliseconds = 50
    reverse: bool = False

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
        """A speed or acceleration in microsteps per second (squared); ValueError outside the controller's range."""
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
        return self.full_steps * self.microsteps * self.gear[0] // self.gear[1]


class RigLaser(LaserTable):
    """A laser: how it appears in a frame, and how long it takes to switch."""

    on_ms: _Milliseconds = 20
    off_ms: _Milliseconds = 20
    """Time from switching off to the exposure; the camera reads the laser-on frame out meanwhile."""

    @property
    def line(self) -> LaserLine:
        """The laser as the stripe extraction takes it."""
        return LaserLine(self.name, self.colour, self.stripe_axis)

    @property
    def table(self) -> LaserTable:
        """The laser as in a capture's header."""
        return LaserTable(name=self.name, colour=self.colour, stripe_axis=self.stripe_axis)


class TriggerTable(FileModel):
    """The wire from the controller to the camera."""

    pulse_ms: Annotated[Integer, pydantic.Field(ge=1, le=5000)] | None = None
    """Length of a trigger pulse; by default the exposure time, rounded up."""
    gap_ms: _Milliseconds = 5
    ready_ms: _Milliseconds = 0
    """Longest wait for the camera's ready output before each trigger; 0 if it is not wired."""


class SweepTable(FileModel):
    """The table angles of a sweep."""

    steps: _Count = 3600
    turn_deg: _Angle = 360.0
    """Angle of a pass; the last step is one step before its end. Negative: downwards."""
    start_deg: _Angle = 0.0
    turns: Annotated[Integer, pydantic.Field(ge=1, le=1000)] = 1
    """Number of passes; the table goes home after each, so that no cable winds up."""

    @pydantic.model_validator(mode="after")
    def _turns(self) -> "SweepTable":
        if self.turn_deg == 0:
            raise ValueError("turn_deg: found 0, expected an angle")
        return self


class CalibrationTable(FileModel):
    """The views of the board in a calibration."""

    free_views: Annotated[Integer, pydantic.Field(ge=0, le=1000)] = 24
    """Views from the home angle, the board held differently in each."""
    placements: Annotated[Integer, pydantic.Field(ge=0, le=100)] = 4
    angles_deg: Annotated[tuple[_Angle, ...], pydantic.Field(min_length=2, max_length=1000)] = (
        -15.0,
        -10.0,
        -5.0,
        0.0,
        5.0,
        10.0,
        15.0,
    )
    """Angles of the table for each placement, from its bearing."""
    bearings_deg: Annotated[tuple[_Angle, ...], pydantic.Field(min_length=1, max_length=100)] = (0.0,)
    """Where the table points for the placements, in turn. Boards all around show the errors of its angles."""


class ChecksTable(FileModel):
    """Limits for accepting a pair, a step or a turn. A capture can be resumed after changing them."""

    proof: ProofLimits = ProofLimits()
    retakes: Annotated[Integer, pydantic.Field(ge=0, le=100)] = 3
    late_s: Annotated[Number, pydantic.Field(gt=0, le=60)] = 2.0
    """Longest time from the exposure to the arrival of a frame; waited for only if one is missing [s]."""
    lost_steps_tolerance: Annotated[Integer, pydantic.Field(ge=0, le=100_000)] = 2
    """Microsteps by which home may be missed; if more, the steps since home was last found well are suspect."""
    shift_px: Annotated[Number, pydantic.Field(gt=0, le=1000)] = 1.0
    """How far the line may have moved when a step is taken again and compared."""
    correlation: Annotated[Number, pydantic.Field(gt=0, lt=1)] = 0.75
    """Least accepted correlation of the laser-off frames' structure in such a comparison; 1 for the same view in any
    light."""
    camera_reopens: Annotated[Integer, pydantic.Field(ge=0, le=1000)] = 10
    """Attempts to open a lost camera again, with growing pauses, before the scan ends."""


class RigConfig(FileModel):
    """The configuration file of a rig."""

    controller: ControllerTable = ControllerTable()
    turntable: TurntableTable = TurntableTable()
    laser: Annotated[tuple[RigLaser, ...], pydantic.Field(min_length=1, max_length=MAX_LASERS)] = (RigLaser(),)
    """Lasers in the order of the controller's numbers; each step of a sweep is taken with one laser after the other."""
    camera: CameraSettings
    trigger: TriggerTable = TriggerTable()
    board: BoardTable | None = None
    sweep: SweepTable = SweepTable()
    calibration: CalibrationTable = CalibrationTable()
    checks: ChecksTable = ChecksTable()
    goal_mm: Annotated[Number, pydantic.Field(gt=0, le=1000)] | None = None
    """How well points are to be known [mm]: the console judges calibrations by it. None: it judges none."""

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
                "a laser line needs background on both sides"
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
        return self.turntable.microsteps_per_turn

    def laser_of(self, record: int) -> int:
        """The laser of a record, counted from 0; the lasers take turns."""
        return record % len(self.laser)

    def frame_tables(self, kind: Literal["sweep", "calibration"]) -> dict[str, Any]:
        """The parts of the configuration that the frames of a capture depend on, as TOML tables."""
        tables = self.model_dump(mode="json", exclude={"controller", "checks", "goal_mm"}, exclude_none=True)
        for name in ("calibration", "board") if kind == "sweep" else ("sweep",):
            tables.pop(name, None)
        # The camera may be plugged in elsewhere; its serial number identifies it.
        for name in ("id", "packet_size"):
            tables["camera"].pop(name, None)
        return tables

    def digest(self, kind: Literal["sweep", "calibration"]) -> str:
        """The sha256 of `frame_tables`, as "sha256:<hex>"."""
        text = json.dumps(self.frame_tables(kind), sort_keys=True, allow_nan=False)
        return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def with_exposure(config: RigConfig, exposure_ms: float, gain_db: float) -> RigConfig:
    """The same rig with another exposure time and gain of its camera. Raises ConfigError outside their ranges."""
    if (exposure_ms, gain_db) == (config.camera.exposure_ms, config.camera.gain_db):
        return config
    tables = config.model_dump(mode="json", exclude_none=True)
    tables["camera"] |= {"exposure_ms": exposure_ms, "gain_db": gain_db}
    try:
        return RigConfig.model_validate(tables)
    except pydantic.ValidationError as problem:
        first = problem.errors()[0]
        raise ConfigError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}.") from problem


def load_rig(path: str | Path) -> RigConfig:
    """The configuration of a rig. Raises ConfigError: file, key, the value found and those allowed."""
    return load_toml(path, RigConfig)
