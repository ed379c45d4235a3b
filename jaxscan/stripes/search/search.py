"""The search: where a stripe is looked for, from which signal on, and the prior of its width."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int16

from jaxscan.geometry import Array, across_and_along
from jaxscan.stripes.frames import decode_table
from jaxscan.stripes.search.candidates import thresholds
from jaxscan.stripes.search.speckle import Rows, correct_speckle, learn_speckle
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
    speckle_reason: Int[Array, ""]
    """Why `speckle` is as it is: number of one of `REASONS`."""
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
        speckle_reason=np.zeros((), np.int32),
        log_width=np.zeros((), np.float32),
        width_information=np.zeros((), np.float32),
        near_side=np.asarray(gate.near_side, np.float32),
    )


def noise_of(search: Search) -> NoiseModel:
    """The noise of a search, as a model."""
    return NoiseModel(*(float(getattr(search, field.name)) for field in dataclasses.fields(NoiseModel)))


def learn_search(search: Search, stripes: FrameStripes, setup: ExtractionSetup) -> Search:
    """The search with speckle and width of its first frames' stripes, as far as the settings ask for them.

    Args:
        search: A search without a prior of the width.
        stripes: The stripes that it found, one of each line.
        setup: Frames, laser and settings.
    """
    rows = _rows(search, stripes, setup)
    if setup.settings.speckle is None and not search.speckle:
        contrast, reason, rows = learn_speckle(rows, float(search.electrons_per_dn), setup.sites.pitch)
        search = search._replace(speckle=np.asarray(contrast, np.float32), speckle_reason=np.asarray(reason, np.int32))
    if setup.settings.learn_width:
        log_width, information = learn_widths(rows.width, rows.sigma, rows.valid)
        search = search._replace(
            log_width=np.asarray(log_width, np.float32), width_information=np.asarray(information, np.float32)
        )
    return search


def correct_search(search: Search, first: FrameStripes, again: FrameStripes, setup: ExtractionSetup) -> Search:
    """The search with the contrast of speckle by which stated sigmas are those of the centres' scatter.

    Args:
        search: The search with a learned contrast.
        first: Stripes found without speckle.
        again: Stripes of the same frames, found by `search`.
        setup: Frames, laser and settings.
    """
    plain = _rows(search, first, setup)
    photons = np.where(plain.usable, plain.sigma**2, 0.0)
    contrast = correct_speckle(_rows(search, again, setup), photons, float(search.speckle))
    return search._replace(speckle=np.asarray(contrast, np.float32))


def _rows(search: Search, stripes: FrameStripes, setup: ExtractionSetup) -> Rows:
    """The stripes of the first frames on the lines of the laser's plane."""
    sites = setup.sites
    lines = np.s_[:LEARNED_FRAMES, sites.first_line :: sites.line_step]
    kept = ("u", "sigma", "amplitude", "width", "grey", "chi2")
    u, sigma, amplitude, width, grey, chi2 = (np.asarray(getattr(stripes, name), np.float64)[lines] for name in kept)
    valid = np.asarray(stripes.valid)[lines]
    dark = 2.0 * noise_of(search).variance(grey)
    fitted = valid & (np.asarray(stripes.saturated)[lines] == 0) & (chi2 > 0)
    return Rows(u, sigma, amplitude, width, dark, valid, fitted)
