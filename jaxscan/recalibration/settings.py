"""How a scanner is recalibrated."""

from dataclasses import dataclass, field
from typing import Literal

from jaxscan.reconstruction import ReconstructSettings


@dataclass(frozen=True)
class RecalibrationSettings:
    """How sweeps refine a stored calibration."""

    stations: bool = False
    """Whether every sweep was taken from a place of its own."""
    stripes: ReconstructSettings = field(default_factory=ReconstructSettings)
    """How stripes are found in captures."""
    wall_m: float | None = None
    """Roughness of walls, a standard deviation [m]; None: learned from the residuals."""
    closed: bool | None = None
    """Whether the table's full turn is exactly one turn (a gear without slip); None: no assumption."""
    angles: Literal["model", "steps"] = "model"
    """Errors of the table's angles: `model`, its gain and errors once and twice per turn; `steps`, one angle per
    step as well, smooth but for lost steps."""
    angle_sigma: float | None = None
    """Standard deviation of where the table stops about the angle of its record [rad]; None: learned from the walls."""
    features: bool | None = None
    """Whether features of the laser-off images are tracked from step to step; None: where they have texture."""
    marker_dictionary: str | None = None
    """OpenCV's dictionary of printed markers in the room, such as "DICT_4X4_50"; None: any usual one."""
    p_drift: float = 1e-3
    """Chance below which the rig has drifted [1]."""
    least_gain: float = 1.05
    """Least gain of any direction for which a calibration is updated: old over new standard deviation [1]."""
    points: int = 40_000
    """Points on surfaces that are used at most."""
    max_steps: int = 40
    """Steps of one least-squares solve."""
