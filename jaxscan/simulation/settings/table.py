"""Configuration of the turntable and its sweep."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from jaxscan.simulation.settings.numbers import Angle, Fraction, Gain, Number, Point, Section, Triple


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
