"""From the samples of a candidate to the levels, variances and start of the fit."""

import math

import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.fitting.gaussian_fit import UNUSED_VARIANCE, Start, Window, sample_places
from jaxscan.stripes.frames import Response, decode_table
from jaxscan.stripes.search import Candidates, Search, reach
from jaxscan.stripes.setup import ExtractionSetup


FILTER_VARIANCE = {1: 3.1, 2: 2.8}
"""Addition of the fine filter, its lattice and the pixel to the square of the width between half-maximum
points, by pitch, for widths of 0.7 to 3 px [px^2]."""


def prepare_window(
    block: Candidates, lamp_ratio: Float[Array, " stripes"], search: Search, setup: ExtractionSetup
) -> tuple[Window, Start]:
    """Samples and start of the fit, of a block of candidates [stripes].

    Args:
        block: Candidates of one block, without its leading axis.
        lamp_ratio: Factor by which the light of the laser-off frame is multiplied, of each candidate.
        search: The noise.
        setup: Frames, laser and settings.
    """
    pitch, response, per_dn = setup.sites.pitch, setup.frames.response, search.electrons_per_dn
    bins = block.bins.astype(jnp.float32)
    step = pitch * bins
    per_bin = 1.0 / bins
    used = block.on >= 0.0
    variance = search.read_dn**2 + _rounding(block.on, response)
    level, background = block.on, None
    if block.off is not None:
        level = level - lamp_ratio[None, :] * block.off
        light = jnp.maximum(block.off - search.black_dn, 0.0)
        dark = search.read_dn**2 + _rounding(block.off, response)
        variance = variance + lamp_ratio[None, :] * light / per_dn
        variance = variance + (lamp_ratio * lamp_ratio)[None, :] * (dark + light / per_dn)
    place = jnp.asarray(sample_places(block.on.shape[0]))
    x = place[:, None] * step[None, :] - block.start[None, :]
    # Samples further away belong to something else.
    used &= jnp.abs(x) <= reach(block.extent)[None, :]
    top = jnp.max(jnp.where(used, level, -1e3), 0)
    if block.off is None:
        background = jnp.min(jnp.where(used, level, 1e3), 0)
        background = jnp.clip(background, 0.0, 1e3)
        variance = variance + jnp.maximum(background - search.black_dn, 0.0)[None, :] / per_dn
        top = top - background
    # The half-widths at half of the maximum and at the clipped top give width and amplitude of
    # a Gaussian that is cut off. Where it is not, the filter widened it.
    saturated = block.saturated.astype(jnp.float32)
    flat = 0.5 * pitch * saturated
    spread = jnp.where(saturated > 0, 1.0, FILTER_VARIANCE[pitch])
    squared = (0.25 * block.extent**2 - flat**2) / (2.0 * math.log(2.0)) - spread
    width = jnp.clip(jnp.sqrt(jnp.maximum(squared, 0.36)), 0.6, setup.settings.max_width_px)
    amplitude = jnp.maximum(top, 1.0) * jnp.exp(jnp.minimum(0.5 * (flat / width) ** 2, 1.5))
    window = Window(
        y=level,
        variance=jnp.where(used, variance * per_bin[None, :], UNUSED_VARIANCE),
        step=step,
        aperture=bins,
        shot=per_bin / per_dn,
    )
    return window, Start(block.start, amplitude, width, background)


def _rounding(level: Float[Array, "samples stripes"], response: Response) -> Float[Array, "samples stripes"] | float:
    """Variance that the rounding of a code gives to its linear level [DN^2]."""
    if response == "linear":
        return 1 / 12
    levels, slopes = (jnp.asarray(table, jnp.float32) for table in decode_table(response))
    return jnp.interp(level, levels, slopes**2 / 12)
