"""The search: where a stripe is looked for, from which signal on, and the prior of its width."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int16

from jaxscan.geometry import Array, across_and_along
from jaxscan.stripes.frames import decode_table
from jaxscan.stripes.search.candidates import thresholds
from jaxscan.stripes.search.widths import LEARNED_FRAMES, learn_widths
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes, NoiseModel


class LineGate(NamedTuple):
    """Coordinates across each line that can hold the stripe: `low <= u < high`."""

    low: Int[np.ndarray, " lines"]
    """First coordinate [px]; 0 where nothing fits."""
    high: Int[np.ndarray, " lines"]
    """One past the last coordinate [px]; 0 where nothing fits."""
    near_side: int
    """+1 where the range falls towards higher coordinates, -1 where it grows; 0 if unknown."""


class Search(NamedTuple):
    """Where and from which signal on stripes are looked for; arrays, so a change compiles nothing."""

    low: Int[Array, " lines"]
    """First sample of each line of the laser's plane that may hold the stripe."""
    high: Int[Array, " lines"]
    """The sample behind the last one."""
    thresholds: Int16[Array, "256"]
    """Smallest response of a candidate, by the mean level of its line."""
    levels: Float[Array, "256"]
    """Linear level of each code [DN]."""
    read_dn: Float[Array, ""]
    """Read noise of one frame [DN]."""
    electrons_per_dn: Float[Array, ""]
    """Conversion gain [e-/DN]."""
    black_dn: Float[Array, ""]
    """Level of a pixel without light [DN]."""
    speckle: Float[Array, ""]
    """Contrast of the laser's speckle on one pixel [1]; 0 while nothing is known."""
    log_width: Float[Array, ""]
    """Mean of the logarithm of the width that the fit sees, which integration over a pixel widens [px]."""
    width_information: Float[Array, ""]
    """Information of this mean as a prior of each stripe [1]; 0 while nothing is known."""
    near_side: Float[Array, ""]
    """+1 where the nearer of two stripes has the larger centre, else -1; 0 if unknown."""


def whole_lines(setup: ExtractionSetup, near_side: int = 0) -> LineGate:
    """The gate that lets everything through."""
    across, lines = across_and_along(*setup.image_size, setup.line.stripe_axis)
    return LineGate(np.zeros(lines, np.int32), np.full(lines, across, np.int32), near_side)


def prepare_search(setup: ExtractionSetup, noise: NoiseModel, gate: LineGate, *, has_off: bool) -> Search:
    """The search in frames of this noise.

    Args:
        setup: Frames, laser and settings.
        noise: Noise of a frame.
        gate: The part of each line of the image that may hold the stripe.
        has_off: Whether there are laser-off frames.

    Raises:
        ValueError: If the rule of choice needs a side that is not given.
    """
    settings, sites = setup.settings, setup.sites
    if settings.choice in ("nearest", "farthest") and gate.near_side == 0:
        raise ValueError(f'choice = "{settings.choice}" needs to know which side is near: reconstruct with a scanner.')
    across, lines = across_and_along(*setup.image_size, setup.line.stripe_axis)
    plane = np.arange(sites.first_line, lines // sites.pitch * sites.pitch, sites.line_step)
    offset = np.asarray(sites.offsets)[np.arange(len(plane)) % len(sites.offsets)]
    samples = across // sites.pitch
    first = np.clip((gate.low[plane] - offset) // sites.pitch, 0, samples)
    last = np.clip(-(-(gate.high[plane] - offset) // sites.pitch), 0, samples)
    return Search(
        low=first.astype(np.int32),
        high=last.astype(np.int32),
        thresholds=thresholds(noise, settings, pitch=sites.pitch, has_off=has_off),
        levels=decode_table(setup.frames.response)[0].astype(np.float32),
        read_dn=np.asarray(noise.read_dn, np.float32),
        electrons_per_dn=np.asarray(noise.electrons_per_dn, np.float32),
        black_dn=np.asarray(noise.black_dn, np.float32),
        speckle=np.asarray(noise.speckle if settings.speckle is None else settings.speckle, np.float32),
        log_width=np.zeros((), np.float32),
        width_information=np.zeros((), np.float32),
        near_side=np.asarray(gate.near_side, np.float32),
    )


def learn_search(search: Search, stripes: FrameStripes) -> Search:
    """The search with the width of its first frames' stripes as a prior."""
    width, sigma, valid = (
        np.asarray(field)[:LEARNED_FRAMES] for field in (stripes.width, stripes.sigma, stripes.valid)
    )
    log_width, information = learn_widths(width, sigma, valid)
    return search._replace(
        log_width=np.asarray(log_width, np.float32), width_information=np.asarray(information, np.float32)
    )
