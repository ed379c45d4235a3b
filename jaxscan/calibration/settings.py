"""How a calibration is solved: its unknowns by blocks, which are free, their priors, limits of outliers."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

from jaxscan.errors import CalibrationError
from jaxscan.geometry import CAMERAS, CameraModel, ParameterBlock
from jaxscan.geometry.laser import LASER_BLOCKS
from jaxscan.geometry.motions import MOTION_BLOCKS


BOARD_BLOCKS = (
    ParameterBlock("warp", ("warp.x", "warp.y"), 0.001, "m", prior="warp", sigma=2e-3),
    # No image shows the size of the squares: the prior is how well the board was measured.
    ParameterBlock("pitch", ("pitch",), 0.001, prior="pitch", sigma=1e-4),
)
"""Unknowns of the calibration board, after those of the scanner."""


def board_blocks(modes: int) -> tuple[ParameterBlock, ...]:
    """`BOARD_BLOCKS`, and a block for the modes of a free shape, in units of their priors' standard deviations."""
    names = tuple(f"shape.{mode}" for mode in range(modes))
    return (*BOARD_BLOCKS, ParameterBlock("shape", names, 1.0, prior="shape", sigma=1.0))


def is_mode(name: str) -> bool:
    """Whether an unknown is a mode of the board's shape."""
    return name.startswith("shape.")


_OF_CAMERAS = tuple(block for camera in CAMERAS.values() for block in camera.blocks())
_OF_ALL = _OF_CAMERAS + LASER_BLOCKS + MOTION_BLOCKS + board_blocks(0)
_HELD = ("pitch",)

CAMERA_BLOCKS = tuple(dict.fromkeys(block.name for block in _OF_CAMERAS))
"""Names of the blocks that cameras have."""
BLOCKS = tuple(dict.fromkeys(block.name for block in _OF_ALL))
"""Names of all blocks."""
USUALLY_FREE = tuple(dict.fromkeys(block.name for block in _OF_ALL if not block.optional and block.name not in _HELD))
"""Names of the blocks that are free unless settings say otherwise."""
PRIORS = {block.prior: block.sigma for block in _OF_ALL if block.prior}
"""Standard deviations of the priors, by name."""

if TYPE_CHECKING:
    Block = str
    PriorName = str
else:
    Block = Literal[BLOCKS]
    PriorName = Literal[tuple(PRIORS)]


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
