"""The setup of an extraction; where a stripe is searched, from which signal on, what is believed; what first frames
tell."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int16, UInt8

from jaxscan.geometry import Array, across_and_along
from jaxscan.stripes.frames import FrameFormat, LaserLine, Sites, decode_table, laser_plane, laser_sites
from jaxscan.stripes.peaks import COARSE_NORM, LATTICE_PX
from jaxscan.stripes.speckle import Rows, correct_speckle, learn_speckle
from jaxscan.stripes.stripes import FrameStripes, NoiseModel, StripeSettings


LEARNED_FRAMES = 8
"""Frames from which width and speckle are learned."""
_LEAST_STRIPES = 100
"""If there are fewer stripes, no width is learned."""
_LEAST_SPREAD = 0.1
"""Smallest standard deviation of the prior of the width [1]."""
_WORST = (0.3, 0.5)
"""Standard deviation of a logarithm of the width up to which a stripe tells something [1]; the second where speckle
leaves too few of the first."""


class ExtractionSetup(NamedTuple):
    """Frames of one kind, a laser as they show it, and the settings."""

    image_size: tuple[int, int]
    """Width and height of a frame [px]."""
    frames: FrameFormat
    line: LaserLine
    settings: StripeSettings
    exposures: tuple[float, ...] = (1.0,)
    """Relative exposures of the frames of one record."""
    level: int | None = None
    """Where the exposures are levels of one frame of more than 8 bits, the one that this engine reads."""
    all_candidates: bool = False
    """Whether the other candidates of a line are given too, beside the number of the chosen one."""
    faint: bool = True
    """Whether lines on which none is found are searched together with those around; on print these are no help."""

    @property
    def several(self) -> bool:
        """Whether a frame gives a profile for each of its candidates."""
        return self.all_candidates or self.settings.choice == "all"

    @property
    def sites(self) -> Sites:
        """Which pixels of a frame carry the laser's colour."""
        return laser_sites(self.frames.pixel_format, self.line)

    @property
    def image_lines(self) -> int:
        """Lines of a profile."""
        return across_and_along(*self.image_size, self.line.stripe_axis)[1]

    def plane(self, frames: Array) -> UInt8[Array, "frames lines samples"]:
        """The samples of the laser's colour of frames uint8 [frames, rows, columns] (rgb8: and 3)."""
        return laser_plane(frames, pixel_format=self.frames.pixel_format, line=self.line)


class LineGate(NamedTuple):
    """Coordinates across each line that can hold the stripe: `low <= u < high`."""

    low: Int[np.ndarray, " lines"]
    """First coordinate [px]; 0 where nothing fits."""
    high: Int[np.ndarray, " lines"]
    """One past the last coordinate [px]; 0 where nothing fits."""
    near_side: int
    """+1 where the range falls towards higher coordinates, -1 where it grows; 0 if unknown."""


class Limits(NamedTuple):
    """The numbers of `StripeSettings` that compiled code takes, so that another setting compiles nothing."""

    saturation: Int[Array, ""]
    iterations: Int[Array, ""]
    clipped_iterations: Int[Array, ""]
    least_snr: Float[Array, ""]
    min_snr: Float[Array, ""]
    continued_snr: Float[Array, ""]
    min_width_px: Float[Array, ""]
    max_width_px: Float[Array, ""]
    max_sigma_px: Float[Array, ""]
    max_chi2: Float[Array, ""]
    max_misfit: Float[Array, ""]
    guard_edges: Float[Array, ""]
    """1 where an edge under the stripe widens its sigma, else 0."""

    @classmethod
    def of(cls, settings: StripeSettings) -> "Limits":
        whole = ("saturation", "iterations", "clipped_iterations")
        kinds = {name: np.int32 if name in whole else np.float32 for name in cls._fields}
        return cls(*(np.asarray(getattr(settings, name), kind) for name, kind in kinds.items()))


class Search(NamedTuple):
    """Where and from which signal on stripes are looked for; arrays, so a change compiles nothing."""

    low: Int[Array, " lines"]
    """First sample of each line of the laser's plane that may hold the stripe."""
    high: Int[Array, " lines"]
    """The sample behind the last one."""
    thresholds: Int16[Array, "256"]
    """Smallest response of a candidate, by the level of the room around it."""
    levels: Float[Array, "256"]
    """Linear level of each code [DN]."""
    rounding: Float[Array, "256"]
    """Variance that rounding gives to that level [DN^2]."""
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
    limits: Limits


def thresholds(noise: NoiseModel, settings: StripeSettings, *, pitch: int, has_off: bool) -> Int16[np.ndarray, "256"]:
    """Smallest response of a candidate, by the level of the room around it [DN].

    Args:
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


def whole_lines(setup: ExtractionSetup, near_side: int = 0) -> LineGate:
    """The gate that lets everything through."""
    across, lines = across_and_along(*setup.image_size, setup.line.stripe_axis)
    return LineGate(np.zeros(lines, np.int32), np.full(lines, across, np.int32), near_side)


def prepare_search(setup: ExtractionSetup, noise: NoiseModel, gate: LineGate, *, has_off: bool) -> Search:
    """The search in frames of this noise.

    Args:
        gate: The part of each line of the image that may hold the stripe.

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
    levels, slopes = decode_table(setup.frames.response)
    return Search(
        low=first.astype(np.int32),
        high=last.astype(np.int32),
        thresholds=thresholds(noise, settings, pitch=sites.pitch, has_off=has_off),
        levels=levels.astype(np.float32),
        rounding=(slopes**2 / 12).astype(np.float32),
        read_dn=np.asarray(noise.read_dn, np.float32),
        electrons_per_dn=np.asarray(noise.electrons_per_dn, np.float32),
        black_dn=np.asarray(noise.black_dn, np.float32),
        speckle=np.asarray(noise.speckle if settings.speckle is None else settings.speckle, np.float32),
        speckle_reason=np.zeros((), np.int32),
        log_width=np.zeros((), np.float32),
        width_information=np.zeros((), np.float32),
        near_side=np.asarray(gate.near_side, np.float32),
        limits=Limits.of(settings),
    )


def noise_of(search: Search) -> NoiseModel:
    """The noise of a search, as a model."""
    return NoiseModel(*(float(getattr(search, field.name)) for field in dataclasses.fields(NoiseModel)))


def learn_search(search: Search, stripes: FrameStripes, setup: ExtractionSetup) -> Search:
    """The search with speckle and width of its first frames' stripes, as far as the settings ask for them.

    Args:
        search: A search without a prior of the width.
        stripes: The stripes that it found, one of each line.
    """
    rows = _rows(search, stripes, setup)
    if setup.settings.speckle is None and not search.speckle:
        contrast, reason, rows = learn_speckle(rows, float(search.electrons_per_dn), setup.sites.pitch)
        search = search._replace(speckle=np.asarray(contrast, np.float32), speckle_reason=np.asarray(reason, np.int32))
        if contrast > 0.0:
            # A profile with speckle is no Gaussian, and its start is worse.
            search = search._replace(limits=search.limits._replace(iterations=search.limits.clipped_iterations))
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
    # Faint ones that chance made fainter still were not found: their scatter tells less than there is.
    clear = np.asarray(stripes.snr)[lines] >= np.asarray(search.limits.least_snr)
    fitted = valid & clear & (np.asarray(stripes.saturated)[lines] == 0) & (chi2 > 0)
    return Rows(u, sigma, amplitude, width, dark, valid, fitted)


def learn_widths(
    width: Float[np.ndarray, "frames lines"],
    sigma: Float[np.ndarray, "frames lines"],
    valid: Bool[np.ndarray, "frames lines"],
) -> tuple[float, float]:
    """Mean of the logarithm of the width [px], and the prior's information (0: nothing is known).

    Of a faint stripe the samples tell the width badly, and a fit of the wrong width finds a worse centre. The width of
    the other stripes is therefore a prior: a normal distribution of the logarithm of the width, whose spread is the
    stripes' own, without that of their noise.

    Args:
        width: Fitted standard deviations of some frames' stripes [px].
        sigma: Standard deviation of their centres [px]; relative to the width that of a
            logarithm of the width too, as long as amplitude and width are unknown.
    """
    safe = np.where(valid, width, 1.0)
    noise = (sigma / safe) ** 2
    for worst in _WORST:
        used = valid & (noise < worst**2)
        if np.count_nonzero(used) >= _LEAST_STRIPES:
            break
    else:
        return 0.0, 0.0
    # Integration over a pixel widens the stripe that the fit sees.
    logarithm = 0.5 * np.log(safe[used] ** 2 + 1 / 12)
    low, middle, high = np.percentile(logarithm, [15.9, 50.0, 84.1])
    own = max((0.5 * (high - low)) ** 2 - float(np.mean(noise[used])), _LEAST_SPREAD**2)
    return float(middle), 1.0 / own
