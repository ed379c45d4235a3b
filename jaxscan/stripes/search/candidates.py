"""The result of `locate`, which the fit takes: up to three candidates per line, each with the samples around it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Int16

from jaxscan.geometry import Array
from jaxscan.stripes.stripes import NoiseModel, StripeSettings


CANDIDATES = 3
"""Candidates of a line."""
LATTICE_PX = 2
"""Spacing of the points on which candidates are searched [px]."""
HALF_SPAN = 12
"""Lattice points on either side of a maximum in which its extent is measured."""
ZONE_SPAN = 24
"""Lattice points on either side of a maximum that may belong to it."""
NARROW, WIDE = 16, 24
"""Samples of a fit's window: that of most stripes, and that of the others."""
BIN_EXTENT_PX = 13.0
"""Extent from which two samples of a wide window are taken as one [px]."""
FINE_NORM, COARSE_NORM = np.sqrt(6.0), np.sqrt(22.0)
"""Root sums of squares of the two filters' weights on the lattice."""
FINE_SHIFT = 3
"""2 - 1 / 8 brings the fine filter's response to the noise of the coarse one's, within 2 %."""
LANES = 32
"""Candidates of a block that native code fits: a few vectors."""
NO_LEVEL = -1.0
"""Level of a sample that does not count: outside the image, too far away, or clipped [DN]."""


class Candidates(NamedTuple):
    """Candidates of the frames of a chunk, packed in blocks; only the first `total` are real."""

    total: Int[Array, ""]
    frame: Int[Array, "blocks size"]
    """Which frame of the chunk holds it."""
    start: Float[Array, "blocks size"]
    """The candidate, from the middle of its window [px]."""
    extent: Float[Array, "blocks size"]
    """Distance between its half-maximum points, widened by the filter [px]."""
    middle: Float[Array, "blocks size"]
    """Middle of the window, from the line's first sample [px]."""
    bins: Int[Array, "blocks size"]
    """Neighbouring samples of the line that are taken as one."""
    saturated: Int[Array, "blocks size"]
    """Saturated pixels that belong to the candidate."""
    on: Float[Array, "blocks samples size"]
    """Linear level with the laser on [DN]; NO_LEVEL where the sample does not count."""
    off: Float[Array, "blocks samples size"] | None
    """Linear level with the laser off [DN]; 0 outside the image."""


class Located(NamedTuple):
    """All candidates of a chunk, and where those of each line are."""

    lists: tuple[Candidates, ...]
    slots: Int[Array, "frames lines candidates"]
    """Index among the candidates of all lists, counted with their padding; -1 where there is none.
    The highest maximum of a line comes first."""


def thresholds(noise: NoiseModel, settings: StripeSettings, *, pitch: int, has_off: bool) -> Int16[np.ndarray, "256"]:
    """Smallest response of a candidate, by the mean level of its line [DN].

    Args:
        noise: Noise of a frame.
        settings: With the signal-to-noise ratio from which a maximum is a candidate.
        pitch: Distance between samples [px]: a lattice point adds up two samples, or is one.
        has_off: Whether a laser-off frame is subtracted; else the mean of eight lattice points is.
    """
    level = np.arange(256.0)
    variance = noise.variance(level)
    samples = LATTICE_PX / pitch
    # The surround counts four times (the triangle's weight) with an eighth of the variance.
    spread = COARSE_NORM**2 * (2.0 if has_off else 1.0) + (0.0 if has_off else 2.0)
    response = settings.candidate_snr * np.sqrt(spread * samples * variance)
    return np.clip(np.ceil(response), 2, 32000).astype(np.int16)


def fixed_point(lamp_ratio: Float[Array, " frames"]) -> Int[Array, " frames"]:
    """Ratios as the integer search takes them, in 1/128."""
    xp = np if isinstance(lamp_ratio, np.ndarray) else jnp
    return xp.clip(xp.round(128.0 * lamp_ratio), 0, 256).astype(np.int32)


def reach(extent: Array) -> Array:
    """Distance within which samples belong to a candidate [px]."""
    return extent + 1.0
