"""From a candidate's samples to what the fit takes: levels, their variance, and where it starts."""

import math

import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.fitting.fit import UNUSED, Start, Window, sample_places
from jaxscan.stripes.frames.formats import Response, decode_table
from jaxscan.stripes.search.candidates import Candidates, reach
from jaxscan.stripes.stripes import StripeSettings


_FILTER_VARIANCE = {1: 3.1, 2: 2.8}
"""What the fine filter, its lattice and the pixel add to the square of the width that half-maximum
points speak of, by pitch, for widths of 0.7 to 3 px [px^2]."""


def prepare_window(
    block: Candidates,
    pitch: int,
    noise_read: Float[Array, ""],
    noise_gain: Float[Array, ""],
    gain: Float[Array, " stripes"],
    response: Response,
    settings: StripeSettings,
) -> tuple[Window, Start]:
    """What the fit takes of a block of candidates [stripes].

    Args:
        block: Candidates of one block, without its leading axis.
        pitch: Distance between samples of a line [px].
        noise_read: Read noise of one frame [DN].
        noise_gain: Conversion gain [e-/DN].
        gain: By what the light of the laser-off frame is multiplied.
        response: "linear", or "srgb", of which rounding is coarser in the light.
        settings: Largest width, and the speckle of the stripe.
    """
    bins = block.bins.astype(jnp.float32)
    step = pitch * bins
    per_bin = 1.0 / bins
    used = block.on >= 0.0
    variance = noise_read**2 + _rounding(block.on, response)
    level, background = block.on, None
    if block.off is not None:
        scaled = gain[None, :] * block.off
        level = level - scaled
        dark = noise_read**2 + _rounding(block.off, response)
        variance = variance + scaled / noise_gain + (gain * gain)[None, :] * (dark + block.off / noise_gain)
    place = jnp.asarray(sample_places(block.on.shape[0]))
    x = place[:, None] * step[None, :] - block.start[None, :]
    # What lies further away belongs to something else.
    used &= jnp.abs(x) <= reach(block.extent)[None, :]
    top = jnp.max(jnp.where(used, level, -1e3), 0)
    if block.off is None:
        background = jnp.min(jnp.where(used, level, 1e3), 0)
        background = jnp.clip(background, 0.0, 1e3)
        variance = variance + background[None, :] / noise_gain
        top = top - background
    # The half-widths at half of the maximum and at the clipped top give width and amplitude of
    # a Gaussian that is cut off. Where it is not, the filter widened it.
    saturated = block.saturated.astype(jnp.float32)
    flat = 0.5 * pitch * saturated
    spread = jnp.where(saturated > 0, 1.0, _FILTER_VARIANCE[pitch])
    squared = (0.25 * block.extent**2 - flat**2) / (2.0 * math.log(2.0)) - spread
    width = jnp.clip(jnp.sqrt(jnp.maximum(squared, 0.36)), 0.6, settings.max_width_px)
    amplitude = jnp.maximum(top, 1.0) * jnp.exp(jnp.minimum(0.5 * (flat / width) ** 2, 1.5))
    window = Window(
        y=level,
        variance=jnp.where(used, variance * per_bin[None, :], UNUSED),
        step=step,
        aperture=bins,
        shot=per_bin / noise_gain,
    )
    return window, Start(block.start, amplitude, width, background)


def _rounding(level: Float[Array, "samples stripes"], response: Response) -> Float[Array, "samples stripes"] | float:
    """Variance that the rounding of a code gives to its linear level [DN^2]."""
    if response == "linear":
        return 1 / 12
    levels, slopes = (jnp.asarray(table, jnp.float32) for table in decode_table(response))
    return jnp.interp(level, levels, slopes**2 / 12)
