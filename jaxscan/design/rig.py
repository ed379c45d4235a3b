"""The wish for a rig, the rig, and its depth uncertainty by the kinematics."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.errors import OptionError
from jaxscan.geometry import LaserSheet, Pinhole, Rig, Scanner, lit_points, lit_slopes


LENSES_MM = (3.5, 4.0, 5.0, 6.0, 8.0, 12.0, 16.0, 25.0, 35.0, 50.0)
"""Focal lengths in which lenses for machine vision are usually made."""
BASELINES_M = (0.03, 0.05, 0.08, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0)
"""Distances from camera to laser that are tried, in steps of about a quarter."""


@dataclass(frozen=True)
class Sensor:
    """A camera's sensor, as it stands in the rig: the stripe runs along its height."""

    width: int
    """Pixels across the stripe."""
    height: int
    """Pixels along the stripe, one point each."""
    pixel_m: float
    """Side of a pixel [m]."""


SENSORS = (
    Sensor(1280, 1024, 4.8e-6),
    Sensor(1440, 1080, 3.45e-6),
    Sensor(2048, 1536, 3.45e-6),
    Sensor(2448, 2048, 3.45e-6),
    Sensor(4096, 3000, 3.45e-6),
)
"""Classes of global-shutter sensors, fewest pixels first."""
STRIPE_NOISE_PX = 0.1
"""Noise of 0.06 to 0.11 px was measured for stripes of 40 to 80 DN on walls of the path-traced rooms: "sweep, 40–80 DN"
in experiments/results/unkind.md."""
CALIBRATION_PX = 0.05
"""An allowance: the sheets calibrated in the path-traced rooms were 0.02 to 0.07 px beside their true places:
"laser plane at 2.5 m: disparity" in experiments/results/unkind.md."""


@dataclass(frozen=True)
class RigWish:
    """The wanted accuracy, and the bounds of what may be built."""

    range_m: float
    """Depth at which the accuracy is wanted [m]."""
    sigma_m: float
    """Wanted standard deviation of a single point's depth there [m]."""
    sensors: tuple[Sensor, ...] = SENSORS
    """Sensors that may be used, in the order of preference."""
    lenses_mm: tuple[float, ...] = LENSES_MM
    baselines_m: tuple[float, ...] = BASELINES_M
    longest_baseline_m: float = 0.6
    """Longer rigs are hard to keep stiff, and see less behind things."""
    field_deg: float = 40.0
    """Smallest field of view along the stripe [deg]."""
    stripe_px: float = STRIPE_NOISE_PX
    """Standard deviation of a stripe's centre [px]."""
    calibration_px: float = CALIBRATION_PX
    """Allowance for the calibration, as a shift of the stripe in the image [px]."""

    def __post_init__(self) -> None:
        for name in ("range_m", "sigma_m", "longest_baseline_m", "field_deg", "stripe_px"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise OptionError(f"RigWish.{name}: found {value:g}, expected a number above 0.")
        if not (math.isfinite(self.calibration_px) and self.calibration_px >= 0):
            raise OptionError(f"RigWish.calibration_px: found {self.calibration_px:g}, expected 0 or more.")
        if not (self.sensors and self.lenses_mm and self.baselines_m):
            raise OptionError("RigWish: found no sensor, no lens or no baseline, expected at least one of each.")

    @property
    def noise_px(self) -> float:
        """Both parts together, as a shift of the stripe [px]."""
        return math.hypot(self.stripe_px, self.calibration_px)


# How far points of a rig on paper are off, by the kinematics that the reconstruction itself uses.
#
# A stripe that lies $\sigma$ beside its place moves its point by $\sigma\,\partial p / \partial u$, along the sheet.
# The derivative is that of `slopes`; on the optical axis it is $z^2 / (f b)$ in depth.

_LINES = 64
"""Lines of the image, in the middles of as many equal strips, that stand for all of them."""


class Spread(NamedTuple):
    """Standard deviations [m] at several depths, over the lines of the image as root mean square."""

    depth_m: Float[np.ndarray, " depths"]
    depth: Float[np.ndarray, " depths"]
    """Along the optical axis."""
    across: Float[np.ndarray, " depths"]
    """Across the stripe."""
    along: Float[np.ndarray, " depths"]
    """Along the stripe."""


@dataclass(frozen=True)
class RigDesign:
    """A camera that looks along z, and a laser beside it whose upright sheet crosses the optical axis."""

    sensor: Sensor
    lens_mm: float
    baseline_m: float
    """Distance from the camera's centre of projection to the laser, along the image's x."""
    crossing_m: float
    """Depth at which the sheet crosses the optical axis [m]."""

    @property
    def focal_px(self) -> float:
        """Focal length [px]."""
        return self.lens_mm / 1e3 / self.sensor.pixel_m

    @property
    def fields_deg(self) -> tuple[float, float]:
        """Fields of view across and along the stripe [deg]."""
        across, along = (2 * math.atan(n / 2 / self.focal_px) for n in (self.sensor.width, self.sensor.height))
        return math.degrees(across), math.degrees(along)

    @property
    def laser_angle_deg(self) -> float:
        """How far the laser is turned towards the optical axis [deg]; 0 is parallel to it."""
        return math.degrees(math.atan2(self.baseline_m, self.crossing_m))

    @property
    def fan_deg(self) -> float | None:
        """The smallest usual fan that fills the image along the stripe [deg]; None where a usual one is too narrow."""
        return next((fan for fan in FANS_DEG if fan >= self.fields_deg[1]), None)

    @property
    def view_m(self) -> tuple[float, float]:
        """Depths [m] between which the stripe is in the image, seen in its middle line; the second may be infinite.

        The stripe of depth z lies f b (1/z - 1/c) beside the optical axis, and the image ends half its width there.
        """
        half = self.sensor.width / 2 / (self.focal_px * self.baseline_m)
        farthest = 1 / self.crossing_m - half
        return 1 / (1 / self.crossing_m + half), (1 / farthest if farthest > 0 else math.inf)

    def points_per_degree(self) -> float:
        """Points along the stripe in a degree, in the image's middle."""
        return self.focal_px * math.radians(1.0)

    def widest_line_m(self, depth_m: float) -> float:
        """Widest line (1/e² of its brightness, full width) whose stripe is found well at a depth [m]."""
        return 4 * math.sqrt(WIDEST_STRIPE_PX**2 - BLUR_PX**2) * depth_m / self.focal_px

    def scanner(self) -> Scanner:
        """The rig as a perfect scanner that stands still: its frame is the camera's."""
        focal = np.asarray(self.focal_px)
        width, height = self.sensor.width, self.sensor.height
        middle = np.asarray((width - 1) / 2), np.asarray((height - 1) / 2)
        camera = Pinhole(focal, focal, middle[0], middle[1], np.zeros(5), width, height)
        sheet = LaserSheet.from_plane([1 / self.baseline_m, 0.0, 1 / self.crossing_m], 1.0)
        return Scanner.from_parts(camera, sheet)


def spread_at(design: RigDesign, depths_m: Sequence[float], noise_px: float) -> Spread:
    """Standard deviations of single points on planes at several depths.

    Args:
        depths_m: z in the camera frame [m].
        noise_px: Standard deviation of a stripe's centre [px].
    """
    rig = design.scanner().rig
    lines = (np.arange(_LINES) + 0.5) / _LINES * design.sensor.height - 0.5
    moved = np.stack([_shift_per_pixel(rig, lines, float(depth)) for depth in depths_m])
    rms = noise_px * np.sqrt(np.mean(moved**2, axis=1))
    return Spread(np.asarray(depths_m, np.float64), rms[:, 2], rms[:, 0], rms[:, 1])


def depth_sigma(design: RigDesign, depth_m: float, noise_px: float) -> float:
    """Standard deviation of a single point's depth on a plane at this depth [m]."""
    return float(spread_at(design, [depth_m], noise_px).depth[0])


def _shift_per_pixel(rig: Rig, lines: Float[np.ndarray, " lines"], depth: float) -> Float[np.ndarray, "lines 3"]:
    """Movement [m/px] of the points of a plane at this depth, camera frame."""
    camera, sheet = rig.camera, rig.laser(0)
    y = (lines - camera.cy) / camera.fy * depth
    x = (sheet.distance - sheet.normal[1] * y - sheet.normal[2] * depth) / sheet.normal[0]
    q = np.stack([np.asarray(camera.project(np.stack([x, y, np.full_like(y, depth)], -1)))[:, 0], lines], -1)
    return np.asarray(lit_slopes(rig, *lit_points(rig, q, 0), 0))[..., 0]


FANS_DEG = (30.0, 45.0, 60.0, 75.0, 90.0, 110.0)
"""Fan angles in which line lasers are usually made."""
WIDEST_STRIPE_PX = 3.0
"""Width (standard deviation) to which experiments/results/stripe_accuracy.md has stripes found as well as can be; the
narrower ones, down to 0.7 px, to fewer hundredths of a pixel."""
BLUR_PX = 0.8
"""Blur of lens and pixel (standard deviation) that is part of the stripe's width, and all of a thin line's."""
