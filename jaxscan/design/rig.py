"""A rig on paper: sensor, lens, baseline, and where the sheet crosses the optical axis."""

import math
from dataclasses import dataclass

import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner


FANS_DEG = (30.0, 45.0, 60.0, 75.0, 90.0, 110.0)
"""Fan angles in which line lasers are usually made."""
WIDEST_STRIPE_PX = 3.0
"""Width (standard deviation) to which experiments/results/stripe_accuracy.md has stripes found as well as can be; the
narrower ones, down to 0.7 px, to fewer hundredths of a pixel."""
BLUR_PX = 0.8
"""Blur of lens and pixel (standard deviation) that is part of the stripe's width, and all of a thin line's."""


@dataclass(frozen=True)
class Sensor:
    """A camera's sensor, as it stands in the rig: the stripe runs along its height."""

    width: int
    """Pixels across the stripe."""
    height: int
    """Pixels along the stripe, one point each."""
    pixel_m: float
    """Side of a pixel [m]."""


@dataclass(frozen=True)
class RigDesign:
    """A camera that looks along z, and a laser beside it whose upright sheet crosses the optical axis."""

    sensor: Sensor
    lens_mm: float
    baseline_m: float
    """From the camera's centre of projection to the laser, along the image's x."""
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
