"""Stripe centres on the grid [profile, line], and the settings of their extraction."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.geometry import Array


class Stripes(eqx.Module):
    """Sub-pixel stripe centres: one profile per laser in a record, one line per image row.

    Where a laser's stripe runs along the rows of the image ("columns" as `stripe_axis`), a line
    is an image column. Entries that are not `valid` are zero.
    """

    u: Float[Array, "profiles lines"]
    """Stripe centre across the line [px]."""
    sigma: Float[Array, "profiles lines"]
    """Standard deviation of `u` [px]."""
    amplitude: Float[Array, "profiles lines"]
    """Peak of the fitted Gaussian above the background [DN], before pixel integration."""
    width: Float[Array, "profiles lines"]
    """Standard deviation of the fitted Gaussian [px]."""
    chi2: Float[Array, "profiles lines"]
    """Chi-squared of the fit per degree of freedom [1]."""
    skew: Float[Array, "profiles lines"]
    """Skewness of the stripe's profile, from the residuals of its fit [1]."""
    saturated: UInt8[Array, "profiles lines"]
    """Number of saturated pixels in the fitted window."""
    valid: Bool[Array, "profiles lines"]
    record: Int[Array, " profiles"]
    """Which record of the sweep the profile comes from."""
    laser: Int[Array, " profiles"]
    """Which laser lit the profile."""
    rgb: UInt8[Array, "profiles lines 3"] | None = None
    """Colour of the laser-off image at the centre, where it was looked at."""


class FrameStripes(NamedTuple):
    """Stripes of a chunk of frames [profiles, lines], or candidates in any arrangement; fields as of `Stripes`."""

    u: Float[Array, "*n"]
    sigma: Float[Array, "*n"]
    amplitude: Float[Array, "*n"]
    width: Float[Array, "*n"]
    chi2: Float[Array, "*n"]
    """0 where no model was fitted."""
    skew: Float[Array, "*n"]
    """0 where it was not measured."""
    snr: Float[Array, "*n"]
    """Signal-to-noise ratio of the whole stripe [1]."""
    grey: Float[Array, "*n"]
    """Linear level of the laser-off frame at the centre [DN]; 0 without one."""
    saturated: UInt8[Array, "*n"]
    valid: Bool[Array, "*n"]


KEPT_FIELDS = tuple(name for name in FrameStripes._fields if name not in ("snr", "grey"))
"""Fields of `FrameStripes` that `Stripes` has too."""


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one frame: variance = read_dn^2 + light / electrons_per_dn (+ 1/12)  [DN^2], light = level - black_dn;
    of the laser's light there is (speckle * light)^2 too."""

    read_dn: float = 1.0
    """Standard deviation of the read noise [DN]."""
    electrons_per_dn: float = 40.0
    """Conversion gain [e-/DN]."""
    black_dn: float = 0.0
    """Level of a pixel without light [DN]."""
    speckle: float = 0.0
    """Contrast of the laser's speckle on one pixel: standard deviation over mean of its light [1]; where it is 0
    it is learned, unless the settings hold it."""

    def variance(self, level):
        """Variance of a pixel of this level, with that of rounding [DN^2]."""
        light = np.maximum(np.asarray(level, np.float64) - self.black_dn, 0.0)
        return self.read_dn**2 + light / self.electrons_per_dn + 1 / 12

    def in_finer_steps(self, factor: float) -> "NoiseModel":
        """The noise of the same electrons where one of these levels is so many [1]."""
        return NoiseModel(self.read_dn * factor, self.electrons_per_dn / factor, self.black_dn * factor, self.speckle)


Choice = Literal["path", "brightest", "nearest", "farthest", "all"]


@dataclass(frozen=True)
class StripeSettings:
    """How stripes are found and which are believed."""

    estimator: str = "gaussian"
    """How a centre is found on a line: "gaussian" fits a Gaussian to every maximum; "centre_of_gravity"
    takes the plain mean of the light around the highest."""
    choice: Choice = "path"
    """Which candidate of a line is the stripe: that on the best path over the lines, the
    brightest, the nearest or farthest one (which needs a calibration), or all of them, as
    profiles of their own."""
    min_snr: float = 5.5
    """Smallest accepted signal-to-noise ratio of a stripe, sqrt(sum signal^2 / variance) [1]."""
    continued_snr: float = 4.2
    """The same on a path, for a line whose neighbours hold the same stripe [1]."""
    candidate_snr: float = 3.6
    """Signal-to-noise ratio of a matched filter from which a maximum is looked at [1]."""
    min_width_px: float = 0.4
    """Smallest accepted standard deviation of a stripe [px]."""
    max_width_px: float = 13.0
    """Largest accepted standard deviation of a stripe [px]."""
    max_sigma_px: float = 1.0
    """Largest accepted standard deviation of a centre; twice that on lines that others around tell of [px]."""
    max_chi2: float = 4.0
    """Largest accepted chi-squared per degree of freedom, but for `max_misfit` [1]."""
    max_misfit: float = 0.5
    """Accepted misfit of a stripe's shape, as a fraction of its root mean square [1]."""
    learn_width: bool = True
    """Whether the width of the first frames' stripes is a prior for all: it helps the faint ones."""
    guard_edges: bool = True
    """Whether an edge of the surface's reflectance under the stripe, as the laser-off frame shows
    it, widens a centre's sigma by the shift that it may have caused."""
    speckle: float | None = None
    """Contrast of the laser's speckle on one pixel: standard deviation over mean of its light [1]; None: learned
    from the first frames, where the noise does not say it."""
    saturation: int = 254
    """Pixels at or above this level [DN] are taken as clipped and left out of the fit."""
    iterations: int = 4
    """Steps of the fit; the error that is left is a fiftieth of the noise."""
    clipped_iterations: int = 8
    """Steps of the fit where pixels are saturated or speckle was learned, of which the start is worse."""

    @property
    def least_snr(self) -> float:
        """Signal-to-noise ratio from which a candidate is measured and judged [1]."""
        return self.continued_snr if self.choice == "path" else self.min_snr
