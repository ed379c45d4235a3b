"""Configuration of a simulated rig, as frozen models that refuse unknown keys.

Metres, radians and pixels unless the key says otherwise.
"""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator, model_validator

from jaxscan.geometry import MAX_PIXELS, AbstractBoard, Charuco, Chessboard, check_board, known_dictionary
from jaxscan.simulation.numbers import (
    MOST_PAIRS,
    Angle,
    Distance,
    Focal,
    Fraction,
    Gain,
    Level,
    Millimetres,
    Name,
    Number,
    Pair,
    Pixels,
    Place,
    Point,
    Section,
    Share,
    Size,
    Triple,
)
from jaxscan.simulation.surroundings import LightSpec, ObjectSpec, RoomSpec


PixelFormat = Literal["mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"]
Colour = Literal["red", "green", "blue"]


# The simulator has its own lens models, so that an error of the estimator's shows; only the names of
# lenses and coefficients are shared with the estimator.
_COEFFICIENTS: dict[str, tuple[str, ...]] = {
    "pinhole": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2", "k3", "k4"),
    "double_sphere": ("xi", "alpha"),
}


class CameraSpec(Section):
    """Pinhole with Brown-Conrady distortion, fisheye after Kannala and Brandt, or double sphere [px; 1]."""

    model: Literal["pinhole", "fisheye", "double_sphere"] = "pinhole"
    width: Size = 1280
    height: Size = 1024
    fx: Focal = 1100.0
    fy: Focal = 1100.0
    cx: Number | None = None
    """Principal point; the middle of the image where not given."""
    cy: Number | None = None
    k1: Number = 0.0
    """This and the other coefficients are those of the model; all others stay 0."""
    k2: Number = 0.0
    p1: Number = 0.0
    p2: Number = 0.0
    k3: Number = 0.0
    k4: Number = 0.0
    xi: Number = 0.0
    alpha: Number = 0.0
    field_deg: Annotated[float, Field(ge=1, le=300)] = 200.0
    """Field of view of a wide-angle lens: the image is dark beyond."""
    up: Literal["-v", "+v", "+u", "-u"] = "-v"

    @model_validator(mode="after")
    def _one_lens(self) -> "CameraSpec":
        every = dict.fromkeys(name for names in _COEFFICIENTS.values() for name in names)
        strange = [name for name in every if name not in _COEFFICIENTS[self.model]]
        if any(getattr(self, name) != 0.0 for name in strange):
            raise ValueError(f"a {self.model} has no {' or '.join(strange)}")
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(f"{self.width} x {self.height} px are more than {MAX_PIXELS // 1_000_000} megapixels")
        return self

    @property
    def wide(self) -> bool:
        """Whether the lens sees beside itself: rays are then found over the angle to the axis."""
        return self.model != "pinhole"

    def coefficients(self) -> dict[str, float]:
        """Coefficients of the lens, by name."""
        return {name: getattr(self, name) for name in _COEFFICIENTS[self.model]}

    def centre(self) -> Pair:
        """Principal point [px]."""
        return (
            (self.width - 1) / 2 if self.cx is None else self.cx,
            (self.height - 1) / 2 if self.cy is None else self.cy,
        )


class SensorSpec(Section):
    """The sensor: response and noise."""

    pixel_format: PixelFormat = "mono8"
    response: Literal["linear", "srgb"] = "linear"
    psf_px: Pixels = 0.7
    """Standard deviation of the lens's Gaussian point-spread function."""
    electrons_per_dn: Level = 40.0
    """Conversion gain of the linear signal; shot noise is its square root in electrons."""
    read_dn: Annotated[float, Field(ge=0, le=1e3)] = 1.0
    """Standard deviation of the read noise, in DN of the linear signal."""
    crosstalk: Share = 0.04
    """Share of the laser's light that the other two channels of a colour camera see."""
    speckle_contrast: Share = 0.0
    """Relative standard deviation of the laser's light on one pixel; 0 for none."""
    speckle_px: Pixels = 1.5
    """Correlation length of the speckle along the stripe (standard deviation of its kernel)."""


class LaserSpec(Section):
    """A line laser: its sheet, its fan, and its power.

    The sheet is given in one of three ways: the paper's `a`, `b`, `c_mm` (a X + b Y + Z = c),
    `normal` and `distance_m`, or `baseline_m` and `crossing_m`: an upright sheet through the
    laser at (baseline, 0, 0) that crosses the optical axis at that depth.
    """

    name: Name = "red"
    colour: Colour = "red"
    stripe_axis: Literal["rows", "columns"] = "rows"
    a: Number | None = None
    b: Number | None = None
    c_mm: Number | None = None
    normal: Triple | None = None
    distance_m: Number | None = None
    baseline_m: Number | None = None
    crossing_m: Number | None = None
    bow: tuple[Fraction, Fraction] = (0.0, 0.0)
    """b2, b3 of the sheet's bow; see LaserSheet."""
    origin_m: Point | None = None
    """Origin of the fan, camera frame. Default: the point of the sheet on the camera's x axis, or, for
    a sheet along that axis, the point nearest the camera."""
    fan_deg: Annotated[float, Field(ge=0.1, lt=180)] = 90.0
    waist_mm: Millimetres = 0.5
    """Standard deviation of the sheet's thickness where it is in focus."""
    focus_m: Annotated[float, Field(ge=0, le=1e4)] = 2.0
    divergence_mrad: Annotated[float, Field(ge=0, le=1e3)] = 0.3
    peak_dn: Level = 150.0
    """Peak of the stripe on a wall of albedo 0.7 that faces the laser at `range_m`."""
    range_m: Distance = 2.0

    @model_validator(mode="after")
    def _one_form(self) -> "LaserSpec":
        forms = {
            "a, b, c_mm": (self.a, self.b, self.c_mm),
            "normal, distance_m": (self.normal, self.distance_m),
            "baseline_m, crossing_m": (self.baseline_m, self.crossing_m),
        }
        begun = [name for name, values in forms.items() if any(value is not None for value in values)]
        whole = [name for name, values in forms.items() if all(value is not None for value in values)]
        if len(begun) != 1 or begun != whole:
            raise ValueError(f"a laser's sheet needs exactly one of: {'; '.join(forms)}; got {begun or 'none'}")
        if self.baseline_m == 0 or self.crossing_m == 0 or self.normal == (0, 0, 0) or self.plane()[1] < 1e-4:
            raise ValueError("the sheet is no plane, or passes the camera at less than 0.1 mm")
        return self

    def plane(self) -> tuple[np.ndarray, float]:
        """Unit normal and distance > 0 [m] of the flat part, camera frame."""
        if self.a is not None and self.b is not None and self.c_mm is not None:
            normal, distance = np.array([self.a, self.b, 1.0]), self.c_mm / 1000
        elif self.normal is not None and self.distance_m is not None:
            normal, distance = np.array(self.normal), self.distance_m
        else:
            normal, distance = np.array([1 / (self.baseline_m or 1), 0.0, 1 / (self.crossing_m or 1)]), 1.0
        length = float(np.linalg.norm(normal)) * (1.0 if distance > 0 else -1.0)
        return normal / length, distance / length


class TurntableSpec(Section):
    """The axis, camera frame at angle 0: `direction` and `point_m`, or the paper's `tr` [mm]."""

    direction: Triple | None = None
    point_m: Point | None = None
    tr: tuple[tuple[Number, Number, Number, Number], ...] | None = None
    gain: Gain = 1.0
    """Turned angle per commanded angle; its sign is about the axis's upward sense."""
    harmonics: tuple[Fraction, Fraction, Fraction, Fraction] = (0.0, 0.0, 0.0, 0.0)
    carries: Literal["scanner", "object"] = "scanner"

    @model_validator(mode="after")
    def _one_form(self) -> "TurntableSpec":
        if (self.tr is None) == (self.direction is None or self.point_m is None):
            raise ValueError("a turntable needs either `direction` and `point_m`, or `tr`")
        if self.tr is not None and len(self.tr) != 4:
            raise ValueError(f"`tr` must be a 4 x 4 matrix, got {len(self.tr)} rows")
        if self.direction is not None and np.linalg.norm(self.direction) < 1e-6:
            raise ValueError("`direction` of the turntable has no length")
        if self.gain == 0:
            raise ValueError("gain = 0: the table does not turn")
        return self


class BoardsSpec(Section):
    """The calibration board and how it is shown to the rig."""

    type: Literal["charuco", "chessboard"] = "charuco"
    columns: Annotated[int, Field(ge=1, le=1000)] = 12
    """Squares of a ChArUco board; inner corners of a chessboard."""
    rows: Annotated[int, Field(ge=1, le=1000)] = 9
    square_mm: Millimetres = 30.0
    marker_mm: Millimetres = 22.0
    dictionary: Annotated[str, AfterValidator(known_dictionary)] = "DICT_5X5_250"
    border_mm: Annotated[float, Field(ge=0, le=1e4)] = 15.0
    """White margin around the printed area."""
    warp_mm: tuple[Place, Place] = (0.0, 0.0)
    """kx, ky of z = kx (1 - x^2) + ky (1 - y^2), with x, y = +-1 at the outermost corners."""
    free_views: Annotated[int, Field(ge=0, le=10_000)] = 30
    """Two of three are crossed by a stripe; every third fills the rest of the image."""
    placements: Annotated[int, Field(ge=0, le=1000)] = 4
    angles: Annotated[int, Field(ge=1, le=1000)] = 9
    """Table angles at which each placement is seen, spread over the field of view."""
    range_m: tuple[Distance, Distance] = (0.8, 2.5)
    tilt_deg: tuple[Angle, Angle] = (20.0, 45.0)
    peak_dn: Level = 120.0
    """Peak of the stripe on the board's white: the laser's power is set for each view."""
    white_dn: Level = 105.0
    """Level of a white surface in mean light while boards are shown."""

    @field_validator("range_m", "tilt_deg")
    @classmethod
    def _ascending(cls, value: Pair) -> Pair:
        if value[0] > value[1]:
            raise ValueError(f"must be [smallest, largest], got {list(value)}")
        return value

    @model_validator(mode="after")
    def _possible(self) -> "BoardsSpec":
        check_board(self.board())
        if self.free_views + self.placements * self.angles > MOST_PAIRS:
            raise ValueError(f"free_views, placements and angles make more than {MOST_PAIRS} pairs")
        return self

    def board(self) -> AbstractBoard:
        """The board of the geometry, for corners and outline."""
        columns, rows, square = self.columns, self.rows, self.square_mm / 1000
        if self.type == "chessboard":
            return Chessboard(columns=columns, rows=rows, square=square)
        return Charuco(
            columns=columns, rows=rows, square=square, marker=self.marker_mm / 1000, dictionary=self.dictionary
        )


class PlanSpec(Section):
    """The sweep."""

    steps: Annotated[int, Field(ge=1, le=MOST_PAIRS)] = 360
    turn_deg: Angle = 360.0
    """Commanded angle of the whole sweep; the last step stands one step before it."""


class SimulationConfig(Section):
    """A rig, its surroundings and its plan; everything is drawn from `seed`."""

    camera: CameraSpec = CameraSpec()
    sensor: SensorSpec = SensorSpec()
    laser: tuple[LaserSpec, ...] = (LaserSpec(baseline_m=0.4, crossing_m=3.0),)
    turntable: TurntableSpec = TurntableSpec(direction=(0.0, -1.0, 0.0), point_m=(0.1, 0.0, -0.1))
    room: RoomSpec | None = None
    object: ObjectSpec | None = None
    light: LightSpec = LightSpec()
    boards: BoardsSpec = BoardsSpec()
    plan: PlanSpec = PlanSpec()
    seed: Annotated[int, Field(ge=0, lt=1 << 63)] = 0

    @field_validator("laser", mode="before")
    @classmethod
    def _single_laser(cls, value: Any) -> Any:
        return value if isinstance(value, list | tuple) else [value]

    @model_validator(mode="after")
    def _consistent(self) -> "SimulationConfig":
        if (self.room is None) == (self.object is None):
            raise ValueError("a simulation needs either [room] or [object]")
        if not self.laser:
            raise ValueError("a simulation needs at least one [[laser]]")
        if len({laser.name for laser in self.laser}) != len(self.laser):
            raise ValueError("the lasers' names must differ")
        return self
