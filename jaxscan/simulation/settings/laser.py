"""Configuration of a line laser."""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from jaxscan.simulation.settings.camera import SensorSpec
from jaxscan.simulation.settings.numbers import (
    Distance,
    Fraction,
    Level,
    Millimetres,
    Name,
    Number,
    Point,
    Section,
    Share,
    Triple,
)


Colour = Literal["red", "green", "blue"]
_WAVELENGTHS: dict[Colour, float] = {"red": 650.0, "green": 520.0, "blue": 450.0}
"""nm."""


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
