"""The configuration of a simulated rig, with the limits of every number."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from jaxscan.geometry import MAX_PIXELS, AbstractBoard, AprilGrid, Charuco, Chessboard, check_board, known_dictionary


class Section(BaseModel):
    """A table of the configuration."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Number = Annotated[float, Field(ge=-1e6, le=1e6)]
"""Components of vectors, pixels, coefficients of a lens."""
Place = Annotated[float, Field(ge=-1e3, le=1e3)]
"""A coordinate, m."""
Distance = Annotated[float, Field(ge=1e-3, le=1e4)]
"""A distance in front of the camera, m."""
Millimetres = Annotated[float, Field(ge=1e-3, le=1e4)]
WIDEST_BLUR_PX = 50.0
Pixels = Annotated[float, Field(ge=0.01, le=WIDEST_BLUR_PX)]
"""Width of a blur, px: the time and memory of rendering grow with it."""
Focal = Annotated[float, Field(ge=1.0, le=1e6)]
Level = Annotated[float, Field(gt=1e-6, le=1e6)]
"""A level of light, DN."""
Fraction = Annotated[float, Field(ge=-1, le=1)]
Gain = Annotated[float, Field(ge=-1e3, le=1e3)]
Angle = Annotated[float, Field(ge=-36_000, le=36_000)]
"""Degrees."""
Share = Annotated[float, Field(ge=0, lt=1)]
Albedo = Annotated[float, Field(gt=0, le=1)]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")]
Size = Annotated[int, Field(ge=8, le=65535)]
"""Width or height of an image, px."""
Pair = tuple[float, float]
Triple = tuple[Number, Number, Number]
Point = tuple[Place, Place, Place]


class TurntableSpec(Section):
    """The axis, camera frame at angle 0: `direction` and `point_m`, or the paper's `tr` [mm]."""

    direction: Triple | None = None
    point_m: Point | None = None
    tr: tuple[tuple[Number, Number, Number, Number], ...] | None = None
    gain: Gain = 1.0
    """Turned angle per commanded angle; its sign is about the axis's upward sense."""
    harmonics: tuple[Fraction, Fraction, Fraction, Fraction] = (0.0, 0.0, 0.0, 0.0)
    stop_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """It stops anywhere within this about the commanded angle: a microstep, or backlash [deg]."""
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


class PlanSpec(Section):
    """The sweep."""

    steps: Annotated[int, Field(ge=1, le=100_000)] = 360
    turn_deg: Angle = 360.0
    """Commanded angle of the whole sweep; the last step stands one step before it."""


class MirrorSpec(Section):
    """A clean mirror on a wall: it has no light of its own, and shows the room and the stripe again."""

    wall: Literal["x0", "x1", "y0", "y1"] = "x1"
    along_m: Place = 1.0
    """Its middle along the wall, from the room's corner."""
    height_m: Place = 1.4
    """Height of its middle above the floor."""
    size_m: tuple[Distance, Distance] = (0.6, 0.8)
    """Width and height."""
    reflects: Share = 0.9


class RoomSpec(Section):
    """A box room with furniture along its walls."""

    size_m: tuple[Distance, Distance, Distance] = (4.2, 5.4, 2.5)
    rig_m: Point = (2.0, 2.6, 1.2)
    """The scanner's origin in the room: from the walls x = 0 and y = 0, and above the floor."""
    yaw_deg: Angle = 20.0
    """Direction of the scanner's x axis in the room, from the room's x towards its y."""
    furniture: bool = True
    mirror: MirrorSpec | None = None

    @model_validator(mode="after")
    def _rig_inside(self) -> "RoomSpec":
        if not all(0 < at < size for at, size in zip(self.rig_m, self.size_m, strict=True)):
            raise ValueError(f"`rig_m` {self.rig_m} must lie inside the room of {self.size_m} m")
        return self


class ObjectSpec(Section):
    """A small object on the turntable's plate, for a table that carries the object."""

    height_m: Distance = 0.12
    base_z_m: Place = -0.06
    """Height of the plate above the scanner's origin."""
    plate_radius_m: Distance = 0.11


class LightSpec(Section):
    """The room's own light."""

    white_dn: Level = 120.0
    """Level of a white surface (albedo 1) in the room's mean light, on every channel."""
    shadows: bool = True
    bounce: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Strength of the laser's light that comes back from lit surfaces: 1 as in nature, 0 for none."""
    flicker: Share = 0.0
    """Standard deviation of the room's light from frame to frame, relative."""


class BoardsSpec(Section):
    """The calibration board and how it is shown to the rig."""

    type: Literal["charuco", "chessboard", "aprilgrid"] = "charuco"
    columns: Annotated[int, Field(ge=1, le=1000)] = 12
    """Squares of a ChArUco board; inner corners of a chessboard; tags of an AprilGrid."""
    rows: Annotated[int, Field(ge=1, le=1000)] = 9
    square_mm: Millimetres = 30.0
    marker_mm: Millimetres = 22.0
    dictionary: Annotated[str, AfterValidator(known_dictionary)] = "DICT_5X5_250"
    tag_mm: Millimetres = 40.0
    """Side of an AprilGrid's tags; `gap_mm` is the distance between them."""
    gap_mm: Millimetres = 12.0
    border_mm: Annotated[float, Field(ge=0, le=1e4)] = 15.0
    """White margin around the printed area."""
    warp_mm: tuple[Place, Place] = (0.0, 0.0)
    """kx, ky of z = kx (1 - x^2) + ky (1 - y^2), with x, y = +-1 at the outermost corners."""
    ink: Albedo = 0.09
    paper: Albedo = 0.85
    uneven: Share = 0.0
    """How far ink and paper differ over the board, as a share of their albedo."""
    print_blur_mm: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation of the print's own blur."""
    gloss: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Lamination: its reflection of lamp and laser in the middle of its lobe, as an albedo."""
    gloss_deg: Annotated[float, Field(ge=0.5, le=45)] = 6.0
    """Width of the lobe (standard deviation): angle between the board's normal and the bisector of light and view."""
    free_views: Annotated[int, Field(ge=0, le=1000)] = 30
    """Two of three are crossed by a stripe; every third fills the rest of the image."""
    placements: Annotated[int, Field(ge=0, le=200)] = 4
    angles: Annotated[int, Field(ge=1, le=360)] = 9
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
        return self

    def table(self) -> dict[str, Any]:
        """The board as the header of a capture describes it."""
        lengths = {
            "charuco": {"square_mm", "marker_mm", "dictionary"},
            "chessboard": {"square_mm"},
            "aprilgrid": {"tag_mm", "gap_mm"},
        }
        return self.model_dump(include={"type", "columns", "rows"} | lengths[self.type])

    def board(self) -> AbstractBoard:
        """The board of the geometry, for corners and outline."""
        columns, rows, square = self.columns, self.rows, self.square_mm / 1000
        if self.type == "chessboard":
            return Chessboard(columns=columns, rows=rows, square=square)
        if self.type == "aprilgrid":
            return AprilGrid(columns=columns, rows=rows, square=self.gap_mm / 1000, tag=self.tag_mm / 1000)
        return Charuco(
            columns=columns, rows=rows, square=square, marker=self.marker_mm / 1000, dictionary=self.dictionary
        )


Colour = Literal["red", "green", "blue"]
_WAVELENGTHS: dict[Colour, float] = {"red": 650.0, "green": 520.0, "blue": 450.0}
"""nm."""


PixelFormat = Literal["mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"]


class SensorSpec(Section):
    """The sensor: response and noise."""

    pixel_format: PixelFormat = "mono8"
    response: Annotated[str, Field(pattern=r"^(linear|srgb|gamma [1-4](\.\d{1,6})?)$")] = "linear"
    """"linear", "srgb", or "gamma 2.2": code = 255 (level / 255)^(1 / 2.2)."""
    bits: Literal[8, 10, 12, 14, 16] = 8
    """Bits of a sample. More than 8 give the same range and noise in finer steps; all levels here are DN of 8 bits."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """The images are compressed to JPEGs of this quality and unpacked again; None: they are not."""
    stated: bool = True
    """Whether the captures' headers state response and compression; if not, they say "linear", as those of strangers
    do."""
    psf_px: Pixels = 0.7
    """Standard deviation of the lens's Gaussian point-spread function."""
    electrons_per_dn: Level = 40.0
    """Conversion gain of the linear signal; shot noise is its square root in electrons."""
    read_dn: Annotated[float, Field(ge=0, le=1e3)] = 1.0
    """Standard deviation of the read noise, in DN of the linear signal."""
    crosstalk: Share = 0.04
    """Share of the laser's light that the other two channels of a colour camera see."""
    black_dn: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Level that the sensor adds to everything, in DN of the linear signal."""
    pixel_um: Annotated[float, Field(ge=0.5, le=50)] = 3.45
    """Side of a pixel: it determines, with the aperture and the laser's wavelength, how large grains of speckle are."""
    f_number: Annotated[float, Field(ge=0.7, le=64)] = 4.0
    """Working f-number of the lens."""
    gain_spread: Share = 0.0
    """Standard deviation of the gain from pixel to pixel, relative; the same in all frames."""
    offset_spread_dn: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of the pixels' own offsets."""
    hot_pixels: Share = 0.0
    """Share of the pixels that have a dark current."""
    hot_dn: Annotated[float, Field(ge=0, le=1e3)] = 40.0
    """Its mean; it is distributed exponentially."""
    vignetting: Share = 0.0
    """Share of the light that is lost in the farthest corner; it grows with the square of the distance from the
    principal point."""
    psf_edge: Annotated[float, Field(ge=0, le=5)] = 0.0
    """How much wider the blur is in the farthest corner, as a share of `psf_px`."""
    focus_m: Distance = 2.0
    """Depth at which the lens is sharp."""
    defocus_px_m: Annotated[float, Field(ge=0, le=50)] = 0.0
    """Blur by defocus, in px for each 1/m of difference to `focus_m`; it adds to `psf_px` in variance."""

    @model_validator(mode="after")
    def _linear(self) -> "SensorSpec":
        if self.bits > 8 and (self.response != "linear" or self.jpeg_quality is not None):
            raise ValueError(f"bits: found {self.bits} with a response or JPEG, expected a linear sensor without")
        return self


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
    side_lobes: tuple[Share, Share] = (0.0, 0.0)
    """Peaks of the lobes beside the sheet, against and along its normal, as shares of the sheet's own peak."""
    lobes_at: Annotated[float, Field(ge=1, le=20)] = 4.0
    """Their distance from the middle, in standard deviations of the sheet; they are as thick as the sheet."""
    uneven_slow: Share = 0.0
    """Amplitude of slow changes of brightness along the line (a few over the fan), relative."""
    uneven_fine: Share = 0.0
    """Standard deviation of fine changes along the line, relative: `fine_deg` wide and smooth."""
    fine_deg: Annotated[float, Field(ge=0.01, le=45)] = 0.5
    widening: Annotated[float, Field(ge=0, le=10)] = 0.0
    """How much thicker the sheet is at the ends of the fan than in its middle, relative."""
    wavelength_nm: Annotated[float, Field(ge=200, le=2000)] | None = None
    """650 for a red laser, 520 for a green one and 450 for a blue one, where not given."""
    speckle_contrast: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Standard deviation over mean of the speckle in a point of the image, before pixels average it; 0 for none."""

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
        if self.baseline_m == 0 or self.crossing_m == 0 or self.normal == (0, 0, 0) or not self.plane()[1] >= 1e-4:
            raise ValueError("the sheet is no plane, or passes the camera at less than 0.1 mm")
        return self

    def grain_px(self, sensor: SensorSpec) -> float:
        """Size lambda N of the grains of speckle on the sensor [px]."""
        wavelength = self.wavelength_nm or _WAVELENGTHS[self.colour]
        return wavelength / 1000 * sensor.f_number / sensor.pixel_um

    def plane(self) -> tuple[np.ndarray, float]:
        """Unit normal and distance > 0 [m] of the flat part, camera frame."""
        if self.a is not None and self.b is not None and self.c_mm is not None:
            normal, distance = np.array([self.a, self.b, 1.0]), self.c_mm / 1000
        elif self.normal is not None and self.distance_m is not None:
            normal, distance = np.array(self.normal), self.distance_m
        else:
            normal, distance = np.array([1 / (self.baseline_m or 1), 0.0, 1 / (self.crossing_m or 1)]), 1.0
        # By Python's numbers: components that are too large give no distance, and no warning of NumPy's.
        length = math.hypot(*normal.tolist()) * (1.0 if distance > 0 else -1.0)
        return np.array([value / length for value in normal.tolist()]), distance / length


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


# Configuration of a simulated rig, as frozen models that refuse unknown keys.
#
# Metres, radians and pixels unless the key says otherwise.

_LARGEST_GRAIN_PX = 16
"""The memory of drawing grows with the square of the grain."""


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
        for laser in self.laser:
            if laser.speckle_contrast > 0 and (grain := laser.grain_px(self.sensor)) > _LARGEST_GRAIN_PX:
                raise ValueError(
                    f"speckle of laser {laser.name!r} has grains of {grain:.0f} px, at most {_LARGEST_GRAIN_PX} can be "
                    "drawn: lower f_number or wavelength_nm, or raise pixel_um"
                )
        return self
