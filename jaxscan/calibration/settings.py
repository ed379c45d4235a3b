"""How a calibration is solved: what is free, what is known beforehand, what is an outlier."""

from dataclasses import dataclass, field
from typing import Literal


Block = Literal[
    "focal",
    "centre",
    "radial",
    "tangential",
    "k3",
    "rational",
    "laser",
    "bow",
    "axis",
    "gain",
    "harmonics",
    "warp",
    "pitch",
]

BLOCKS: dict[Block, tuple[str, ...]] = {
    "focal": ("fx", "fy"),
    "centre": ("cx", "cy"),
    "radial": ("k1", "k2"),
    "tangential": ("p1", "p2"),
    "k3": ("k3",),
    "rational": ("k4", "k5", "k6"),
    "laser": ("n1", "n2", "d"),
    "bow": ("b2", "b3"),
    "axis": ("axis.d1", "axis.d2", "axis.p1", "axis.p2"),
    "gain": ("gain",),
    "harmonics": ("c1", "s1", "c2", "s2"),
    "warp": ("warp.x", "warp.y"),
    "pitch": ("pitch",),
}
"""What can be freed or held together, by the names of the minimal coordinates (those of a laser
without its name, those of the board at the end). Of a fisheye, k1 ... k4 are "radial"."""

CAMERA_BLOCKS: tuple[Block, ...] = ("focal", "centre", "radial", "tangential", "k3", "rational")


@dataclass(frozen=True)
class Priors:
    """Standard deviations of what is known before any image: weak, and reported.

    `inf` switches one off.
    """

    centre_px: float = 50.0
    """Principal point about the image's centre [px]."""
    aspect: float = 2e-3
    """fx / fy about 1 [1]."""
    tangential: float = 2e-3
    """p1, p2 about 0 [1]."""
    k3: float = 1.0
    """k3 (and k4, k5, k6; of a fisheye k3 and k4) about 0 [1]."""
    gain: float = 1e-3
    """|gain| about 1: the accuracy of the table's gears and step count [1]."""
    harmonics: float = 3e-4
    """c1 ... s2 about 0 [rad]."""
    bow: float = 1e-2
    """b2, b3 about 0 [rad / rad^2, rad / rad^3]."""
    warp: float = 2e-3
    """Bow of the board about 0 [m]."""
    pitch: float = 1e-4
    """Relative error of the board's squares about 0 [1]: how well the board was measured."""


@dataclass(frozen=True)
class CalibrationSettings:
    """How observations become a scanner."""

    camera: Literal["pinhole", "fisheye"] = "pinhole"
    """Model of the lens: with distortion after Brown and Conrady, or after Kannala and Brandt."""
    free: tuple[Block, ...] = (
        "focal",
        "centre",
        "radial",
        "tangential",
        "k3",
        "laser",
        "axis",
        "gain",
        "harmonics",
        "warp",
    )
    """What is estimated; everything else is held. "rational" adds k4, k5, k6 to the camera.

    The table's harmonics are free although boards over a few tens of degrees hardly see them:
    their prior then says in the covariance what is not known. Held at 0, a table with errors of
    0.3 mrad gives a covariance that is far too small.

    "pitch" adds the size of the board's squares: no image shows it, so its prior alone says how
    much of every length is uncertain with it."""
    priors: Priors = field(default_factory=Priors)
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
    judge: bool = True
    """Test whether the models suffice, and predict what the covariance means in lengths."""
    max_steps: int = 60
    """Steps of one least-squares solve."""
