"""Settings of a reconstruction."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from jaxscan.stripes import StripeSettings, estimator_of


Smooth = Literal["off", "edge"]


@dataclass(frozen=True)
class ReconstructSettings:
    """Settings of a reconstruction. A change of how stripes are found or of whether steps are checked recompiles."""

    stripes: StripeSettings = field(default_factory=StripeSettings)
    """How stripes are found in the frames."""
    min_range_m: float = 0.05
    """Smallest accepted distance from the camera along the ray [m]."""
    max_range_m: float = 30.0
    """Largest accepted distance from the camera along the ray [m]."""
    min_incidence: float = 1e-3
    """Smallest accepted incidence (`LaserSheet.intersect`), about the sine of the angle between
    ray and sheet: below it a stripe says next to nothing about the range."""
    gate: bool = True
    """Whether stripes are looked for only where the range limits allow them."""
    check_steps: bool = False
    """Whether every centre is checked against the neighbouring table steps, where a true surface
    moves smoothly and a reflection does not; takes two passes and all candidates in memory."""
    smooth: Smooth = "edge"
    """Whether a point uses its neighbours along the stripe: "edge" uses them where the surface is continuous and none
    across an edge, "off" takes every row by itself. With `choice` "all" rows are always by themselves."""
    normals: bool = True
    """Whether normals are computed."""
    chunk_records: int | None = None
    """Records computed at a time; None: 32, or as many as fill about 100 MB with frames."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_range_m < self.max_range_m:
            raise ValueError(
                f"The range limits must satisfy 0 <= min_range_m < max_range_m, "
                f"got {self.min_range_m} and {self.max_range_m}."
            )
        if not self.min_incidence > 0.0:
            raise ValueError(f"`min_incidence` must be positive, got {self.min_incidence}.")
        if self.smooth not in get_args(Smooth):
            raise ValueError(f'`smooth` must be "off" or "edge", got {self.smooth!r}.')
        estimator_of(self.stripes)
        if self.check_steps and self.stripes.choice == "all":
            raise ValueError('`check_steps` compares chosen candidates; with `choice` "all" there are none.')
        if self.chunk_records is not None and self.chunk_records < 1:
            raise ValueError(f"`chunk_records` must be at least 1, got {self.chunk_records}.")

    @property
    def smooths(self) -> bool:
        """Whether centres use their neighbours."""
        return self.smooth == "edge" and self.stripes.choice != "all"


DEFAULTS = ReconstructSettings()
