"""Where candidates are looked for, from which signal on, and what is known of stripes beforehand."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int16

from jaxscan.geometry import Array
from jaxscan.stripes.fitting.widths import LEARNED_FRAMES, learn_widths
from jaxscan.stripes.frames.formats import LaserLine, PixelFormat, Response, decode_table, laser_sites
from jaxscan.stripes.search.candidates import thresholds
from jaxscan.stripes.stripes import FrameStripes, NoiseModel, StripeSettings


class Search(NamedTuple):
    """Where and from which signal on candidates are looked for; arrays, so a change compiles nothing."""

    low: Int[Array, " lines"]
    """First sample of each line of the laser's plane that may hold the stripe."""
    high: Int[Array, " lines"]
    """The sample behind the last one."""
    thresholds: Int16[Array, "256"]
    """Smallest response of a candidate, by the mean level of its line."""
    levels: Float[Array, "256"]
    """Linear level of each code [DN]."""
    read: Float[Array, ""]
    """Read noise of one frame [DN]."""
    gain: Float[Array, ""]
    """Conversion gain [e-/DN]."""
    log_width: Float[Array, ""]
    """Mean of the logarithm of what the fit sees of a stripe's width [px]."""
    width_information: Float[Array, ""]
    """Information of this mean as a prior of each stripe [1]; 0 while nothing is known."""
    near_side: Float[Array, ""]
    """+1 where what is nearer has the larger centre, else -1; 0 if unknown."""


def prepare_search(
    noise: NoiseModel,
    image_size: tuple[int, int],
    *,
    has_off: bool,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    settings: StripeSettings,
    gate: tuple[np.ndarray, np.ndarray] | None = None,
    near_side: float = 0.0,
) -> Search:
    """What a search needs to know beside the frames.

    Args:
        noise: Noise of a frame.
        image_size: Width and height of a frame [px].
        has_off: Whether there are laser-off frames.
        pixel_format: How a frame is to be read.
        response: "linear" or "srgb".
        line: Which stripe to look for.
        settings: How stripes are found.
        gate: For every line of the image the first pixel that may hold the stripe and the one
            behind the last; the whole line where not given.
        near_side: +1 where what is nearer has the larger centre, else -1.

    Raises:
        ValueError: If the rule of choice needs a side that is not given.
    """
    if settings.choice in ("nearest", "farthest") and near_side == 0:
        raise ValueError(f'choice = "{settings.choice}" needs to know which side is near: reconstruct with a scanner.')
    sites = laser_sites(pixel_format, line)
    across, lines = image_size if line.stripe_axis == "rows" else image_size[::-1]
    low, high = (np.zeros(lines, int), np.full(lines, across)) if gate is None else gate
    whole = lines // sites.pitch * sites.pitch
    plane = np.arange(sites.first_line, whole, sites.line_step)
    offset = np.asarray(sites.offsets)[np.arange(len(plane)) % len(sites.offsets)]
    samples = across // sites.pitch
    first = np.clip((low[plane] - offset) // sites.pitch, 0, samples)
    last = np.clip(-(-(high[plane] - offset) // sites.pitch), 0, samples)
    return Search(
        low=first.astype(np.int32),
        high=last.astype(np.int32),
        thresholds=thresholds(noise, settings, pitch=sites.pitch, has_off=has_off),
        levels=decode_table(response)[0].astype(np.float32),
        read=np.asarray(noise.read_dn, np.float32),
        gain=np.asarray(noise.electrons_per_dn, np.float32),
        log_width=np.zeros((), np.float32),
        width_information=np.zeros((), np.float32),
        near_side=np.asarray(near_side, np.float32),
    )


def learn_search(search: Search, stripes: FrameStripes) -> Search:
    """The search with what its first frames' stripes say of the width."""
    width, sigma, valid = (
        np.asarray(field)[:LEARNED_FRAMES] for field in (stripes.width, stripes.sigma, stripes.valid)
    )
    log_width, information = learn_widths(width, sigma, valid)
    return search._replace(
        log_width=np.asarray(log_width, np.float32), width_information=np.asarray(information, np.float32)
    )
