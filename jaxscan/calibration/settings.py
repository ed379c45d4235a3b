"""How a calibration is solved: free blocks, priors, limits of outliers."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal, get_args

from jaxscan.calibration.parameters import BLOCKS, PRIORS, USUALLY_FREE, Block, PriorName
from jaxscan.errors import CalibrationError
from jaxscan.geometry import CAMERAS, CameraModel


RigKind = Literal["camera", "profile", "axis"]
"""A rig that is smaller than the captures would allow: the camera alone; camera and sheets; camera and axis."""


@dataclass(frozen=True)
class CalibrationSettings:
    """How observations become a scanner."""

    camera: CameraModel = "pinhole"
    """Model of the camera, of `CAMERAS`."""
    choose_lens: bool = True
    """Take another model of the lens where it explains the corners better by far (`settle_lens`)."""
    only: RigKind | None = None
    """A smaller rig on purpose; None: the largest that the captures determine."""
    free: tuple[Block, ...] = USUALLY_FREE
    """Blocks that are estimated; everything else is held. Blocks that the camera's model lacks do
    nothing; "rational" adds k4, k5, k6 to a pinhole.

    The table's harmonics are free although boards over a few tens of degrees hardly see them:
    their prior then puts their uncertainty into the covariance. Held at 0, a table with errors of
    0.3 mrad gives a covariance that is far too small.

    "pitch" adds the size of the board's squares: no image shows it, so its prior alone says how
    much of every length is uncertain with it."""
    priors: dict[PriorName, float] = field(default_factory=lambda: dict(PRIORS))
    """Standard deviations of the priors; those not named are as usual, and `inf` switches one off."""
    huber: float = 1.345
    """Residuals beyond this many standard deviations are down-weighted at first [1]."""
    reject_any: float = 5.0
    """If any residual is beyond this many standard deviations ... [1]"""
    reject_all: float = 4.0
    """... all beyond this many are dropped [1]."""
    estimate_noise: bool = True
    """Estimate the noise of corners and of stripes from their residuals; otherwise the given
    sigmas are taken at their word."""
    stripe_correlation: float | None = None
    """Neighbouring stripe points that share one error (speckle): each counts as 1 / this [1].
    None: estimated from the residuals."""
    angle_sigma: float | None = None
    """Standard deviation of where the table or stage stops about the angle or position of its record: microsteps,
    backlash [rad or m]. None: learned from boards that were seen from several positions."""
    judge: bool = True
    """Test whether the models suffice, and predict the uncertainty of lengths."""
    limit_mm: float | None = None
    """A rig whose points are not good to this is refused [mm] (`GoodTo.sigma_mm`)."""
    limit_px: float | None = None
    """A camera whose rays are not good to this is refused [px] (`GoodTo.sigma_px`)."""
    at_m: float | None = None
    """Depth at which points are judged [m]; None: 2.5 m, or as far as the rig reaches."""
    max_steps: int = 60
    """Steps of one least-squares solve."""

    def __post_init__(self) -> None:
        if self.angle_sigma is not None and not 0 <= self.angle_sigma < 1:
            raise CalibrationError(
                f"CalibrationSettings.angle_sigma: found {self.angle_sigma:g}, expected 0 to 1 rad or m."
            )
        _check_known("camera", [self.camera], CAMERAS)
        _check_known("only", [] if self.only is None else [self.only], get_args(RigKind))
        _check_known("free", self.free, BLOCKS)
        _check_known("priors", self.priors, PRIORS)
        for key in ("limit_mm", "limit_px", "at_m"):
            value = getattr(self, key)
            if value is not None and not 0 < value < float("inf"):
                raise CalibrationError(f"CalibrationSettings.{key}: found {value:g}, expected a number above 0.")


def _check_known(key: str, found: Iterable[str], known: Iterable[str]) -> None:
    for name in found:
        if name not in known:
            raise CalibrationError(f"CalibrationSettings.{key}: found {name!r}, expected one of {', '.join(known)}.")
