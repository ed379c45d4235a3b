"""What somebody wants of a rig that is to be built."""

import math
from dataclasses import dataclass

from jaxscan.design.rig import Sensor
from jaxscan.errors import OptionError


LENSES_MM = (3.5, 4.0, 5.0, 6.0, 8.0, 12.0, 16.0, 25.0, 35.0, 50.0)
"""Focal lengths in which lenses for machine vision are usually made."""
BASELINES_M = (0.03, 0.05, 0.08, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0)
"""Distances from camera to laser that are tried, in steps of about a quarter."""
SENSORS = (
    Sensor(1280, 1024, 4.8e-6),
    Sensor(1440, 1080, 3.45e-6),
    Sensor(2048, 1536, 3.45e-6),
    Sensor(2448, 2048, 3.45e-6),
    Sensor(4096, 3000, 3.45e-6),
)
"""Classes of global-shutter sensors, fewest pixels first."""
STRIPE_NOISE_PX = 0.1
"""Of stripes of 40 to 80 DN on the walls of the path-traced rooms, 0.06 to 0.11 px were measured: "sweep, 40–80 DN"
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
