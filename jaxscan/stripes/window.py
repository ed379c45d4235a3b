"""The samples around each candidate, and where the fit starts."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.fit import UNUSED, Start, Window, sharpen
from jaxscan.stripes.frames import Response, decode_table
from jaxscan.stripes.locate import Candidate
from jaxscan.stripes.stripes import StripeSettings


SAMPLES = 24
"""Samples of a fit's window."""
FEW_SAMPLES = 16
"""Samples that hold all that counts of a narrow stripe."""
_BIN_EXTENT_PX = 13.0
"""Distance between half-maximum points from which two samples are taken as one [px]."""
_LATTICE_VARIANCE = 1.7
"""What the lattice adds to the square of a width that is measured on it [px^2]."""


class Placement(NamedTuple):
    """Where the window of every line lies."""

    first: Int[Array, "*frames lines"]
    """Its first sample; may lie outside the image."""
    bins: Int[Array, "*frames lines"]
    """Samples that are taken as one: two for wide stripes, which doubles the window's reach."""
    start: Float[Array, "*frames lines"]
    """The candidate, from the middle of the window [px]."""
    extent: Float[Array, "*frames lines"]
    """Distance between its half-maximum points [px]."""


def place_window(candidate: Candidate, pitch: int) -> Placement:
    """Centre a window on each candidate, of twice the reach where the stripe is wide."""
    wide = (candidate.extent > _BIN_EXTENT_PX) & (pitch == 1)
    bins = jnp.where(wide, 2, 1).astype(jnp.int32)
    first = jnp.floor(candidate.u / pitch + 0.5).astype(jnp.int32) - bins * (SAMPLES // 2)
    return Placement(first, bins, candidate.u - window_middle(first, bins, pitch), candidate.extent)


def window_middle(first: Int[Array, "..."], bins: Int[Array, "..."], pitch: int) -> Float[Array, "..."]:
    """Middle of a window, from the line's first sample [px]."""
    return pitch * (first.astype(jnp.float32) + 0.5 * (SAMPLES * bins - 1).astype(jnp.float32))


def is_near(x: Float[Array, "window #lines"], placement: Placement) -> Bool[Array, "window lines"]:
    """Whether a place [px from the middle of the window] is close enough to belong to the candidate."""
    return jnp.abs(x - placement.start[None, :]) <= 2.5 + 0.75 * placement.extent[None, :]


def cut_window(
    on: UInt8[Array, "lines samples"],
    off: UInt8[Array, "lines samples"] | None,
    placement: Placement,
    pitch: int,
    noise_read: Float[Array, ""],
    noise_gain: Float[Array, ""],
    response: Response,
    settings: StripeSettings,
    *,
    samples: int = SAMPLES,
    binned: bool = True,
) -> tuple[Window, Float[Array, " lines"], Start]:
    """The samples around each candidate, their number of saturated ones, where the fit starts.

    Args:
        samples: Length of the window; its middle stays that of `SAMPLES`.
        binned: Whether any line's samples are taken by two.
    """
    rows, columns = on.shape
    first, bins, u, extent = placement
    first = first + bins * ((SAMPLES - samples) // 2)
    sample = jnp.arange(samples, dtype=jnp.int32)[:, None]
    index = first[None, :] + bins[None, :] * sample
    second = index + bins[None, :] - 1
    inside = (index >= 0) & (second < columns)
    row_start = columns * jnp.arange(rows, dtype=jnp.int32)[None, :]
    index, second = (jnp.clip(i, 0, columns - 1) + row_start for i in (index, second))
    aperture = bins.astype(jnp.float32)
    per_bin = 1.0 / aperture
    x = (pitch * aperture)[None, :] * (sample.astype(jnp.float32) - 0.5 * (samples - 1))

    def read(frame):
        """Mean level, the variance of its rounding, the highest code, how many are saturated."""
        codes = _gather(frame, index)
        if not binned:
            level, rounding = _decode(codes, response)
            return level, rounding, codes, codes >= settings.saturation
        codes_2 = _gather(frame, second)
        (level, rounding), (level_2, rounding_2) = _decode(codes, response), _decode(codes_2, response)
        count = (codes >= settings.saturation).astype(jnp.float32)
        count = count + ((codes_2 >= settings.saturation) & (bins == 2)[None, :]).astype(jnp.float32)
        return 0.5 * (level + level_2), 0.5 * (rounding + rounding_2), jnp.maximum(codes, codes_2), count

    level, rounding, highest, count = read(on)
    variance = noise_read**2 + rounding
    clipped = highest >= settings.saturation
    if off is not None:
        dark, rounding, highest, _ = read(off)
        variance = variance + noise_read**2 + rounding + 2.0 * dark / noise_gain
        clipped = clipped | (highest >= settings.saturation)
        level = level - dark
    # What lies further away belongs to something else.
    near = inside & is_near(x, placement)
    saturated = jnp.sum(jnp.where(near, count.astype(jnp.float32), 0.0), 0)

    background = None
    top = jnp.max(jnp.where(near, level, -1e3), 0)
    if off is None:
        background = jnp.min(jnp.where(near, level, 1e3), 0)
        variance = variance + jnp.maximum(background, 0.0)[None, :] / noise_gain
        top = top - background
    # The half-widths at half of the maximum and at the clipped top give width and amplitude of
    # a Gaussian that is cut off. Where it is not, the lattice's triangle lowered the maximum.
    flat = 0.5 * pitch * saturated
    spread = jnp.where(saturated > 0, 1 / 3, _LATTICE_VARIANCE)
    squared = (0.25 * extent**2 - flat**2) / (2.0 * math.log(2.0)) - spread
    width = jnp.clip(jnp.sqrt(jnp.maximum(squared, 0.64)), 0.8, settings.max_width_px)
    amplitude = jnp.maximum(top, 1.0) * jnp.exp(jnp.minimum(0.5 * (flat / width) ** 2, 1.5))
    window = Window(
        x=x,
        y=level,
        variance=jnp.where(near & ~clipped, variance * per_bin[None, :], UNUSED),
        aperture=aperture,
        shot=per_bin / noise_gain,
    )
    start = Start(u, amplitude, width, background)
    if background is None:
        better = sharpen(window, start)
        whole = saturated == 0
        start = start._replace(u=jnp.where(whole, better.u, u), width=jnp.where(whole, better.width, width))
    return window, saturated, start


def _decode(
    codes: UInt8[Array, "window lines"], response: Response
) -> tuple[Float[Array, "window lines"], Float[Array, "window lines"] | float]:
    """Linear level [DN] of a code, and the variance that rounding gives it [DN^2]."""
    if response == "linear":
        return codes.astype(jnp.float32), 1 / 12
    level, slope = decode_table(response)
    return jnp.asarray(level, jnp.float32)[codes], jnp.asarray(slope**2 / 12, jnp.float32)[codes]


def _gather(samples: Shaped[Array, "..."], index: Int[Array, "..."]) -> Shaped[Array, "..."]:
    """Elements of a flat array; every index must be inside."""
    return jnp.asarray(samples).reshape(-1).at[index].get(mode="promise_in_bounds")
