"""Candidates whose centres are measured, and the candidates of each line as the rules of choice take them."""

from typing import NamedTuple

from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.geometry import Array


class Measured(NamedTuple):
    """Candidates of a chunk of frames, measured and judged; in any order."""

    u: Float[Array, " candidates"]
    """Centre, from the first sample of its line [px]."""
    sigma: Float[Array, " candidates"]
    """Standard deviation of `u` [px]."""
    amplitude: Float[Array, " candidates"]
    """Peak of the stripe [DN]."""
    width: Float[Array, " candidates"]
    """Standard deviation of the stripe [px]."""
    chi2: Float[Array, " candidates"]
    """Chi-squared per degree of freedom [1]; 0 where no model was fitted."""
    skew: Float[Array, " candidates"]
    """Skewness [1]; 0 where it was not measured."""
    snr: Float[Array, " candidates"]
    """Signal-to-noise ratio of the whole stripe [1]."""
    grey: Float[Array, " candidates"]
    """Level of the laser-off frame at the centre [DN]; 0 without one."""
    saturated: UInt8[Array, " candidates"]
    """Number of saturated pixels."""
    valid: Bool[Array, " candidates"]
    """Whether it may be a stripe at all."""


class MeasuredLines(NamedTuple):
    """Measured candidates, and where those of each line are."""

    measured: Measured
    slots: Int[Array, "frames lines k"]
    """Index of each candidate of a line; -1 where there is none."""


class LineCandidates(NamedTuple):
    """Candidates of every line, for the choice among them."""

    u: Float[Array, "frames lines k"]
    """Centres [px]."""
    snr: Float[Array, "frames lines k"]
    """Signal-to-noise ratios [1]."""
    amplitude: Float[Array, "frames lines k"]
    """Amplitudes [DN]."""
    width: Float[Array, "frames lines k"]
    """Standard deviations [px]."""
    valid: Bool[Array, "frames lines k"]
    """Which candidates are believed at all."""
