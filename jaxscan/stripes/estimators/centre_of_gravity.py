r"""The plain estimator: blur, threshold, centre of gravity, on every line by itself.

The difference of the pair (or, without laser-off frames, the frame above the median of its line) is blurred
by (1, 2, 1) / 4. Around the highest sample of a line the part that lies above a fifth of it counts, with
weights $w_i = \max(b_i - t, 0)$ that vanish at the threshold t:

$$u = \frac{\sum x_i w_i}{\sum w_i}, \qquad
  \sigma^2 = \sum_j v_j \left( \frac{\sum_i (x_i - u)\, h_{i-j}}{\sum_i w_i} \right)^2,$$

with the variance $v_j$ of a sample and the blur h. No width is assumed and nothing is fitted: skewed stripes
and reflections beside the stripe pull the centre, and clipping is not corrected.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Sites
from jaxscan.stripes.planes import Plane
from jaxscan.stripes.search import Search
from jaxscan.stripes.stripes import Choice, FrameStripes


_REACH = 16
"""Samples on either side of the highest one that may count."""
_SHARE = 0.2
"""Part of the highest sample below which light does not count [1]."""
_SAMPLING = 0.025
"""Error that sampling leaves in a stripe as wide as a sample [samples]; it falls with the square of the width."""
_BLUR = (0.25, 0.5, 0.25)
_BORDER = ((0, 0), (0, 0), (1, 1))


class Peak(NamedTuple):
    """The highest sample of every line, and the window of samples around it."""

    place: Int[Array, "frames lines"]
    """Number of the sample."""
    inside: Bool[Array, "frames lines window"]
    """Which samples of the window may hold the stripe."""
    light: Float[Array, "frames lines window"]
    """Light of the laser [DN]."""
    room: Float[Array, "frames lines window"]
    """Light of the room [DN]."""
    off: Float[Array, "frames lines window"] | None
    """The same where a laser-off frame shows it."""
    saturated: UInt8[Array, "frames lines"]
    """Clipped samples of the window."""


class CentreOfGravity:
    """One candidate a line: the brightest."""

    candidates = 1
    choices: tuple[Choice, ...] = ("path", "brightest")
    learns = False

    def measure(
        self, on: Plane, off: Plane | None, lamp_ratio: Array, search: Search, sites: Sites, linear: bool
    ) -> FrameStripes:
        """The centre of gravity of the brightest place of every line, its standard deviation by propagation."""
        dark = None if off is None else off.samples[None]
        return _measured(_located(on.samples[None], dark, lamp_ratio[None], search), lamp_ratio, search, sites.pitch)


def _located(on: Array, off: Array | None, lamp_ratio: Array, search: Search) -> Peak:
    """The highest sample of every blurred line."""
    levels, samples = jnp.asarray(search.levels), on.shape[2]
    number = jnp.arange(samples, dtype=jnp.int32)[None, None, :]
    low, high = (jnp.asarray(limit)[None, :, None] for limit in (search.low, search.high))
    gate = (number >= low) & (number < high)
    lit = levels[on]
    room = _median(lit, gate) if off is None else lamp_ratio[:, None, None] * levels[off]
    light = jnp.where(gate, lit - room, -jnp.inf)
    place = jnp.argmax(_blurred(jnp.pad(light, _BORDER, mode="edge")), axis=2).astype(jnp.int32)
    index = place[..., None] + np.arange(-_REACH - 1, _REACH + 2, dtype=np.int32)[None, None, :]
    inside = (index >= low) & (index < high)
    index = jnp.clip(index, 0, samples - 1)

    def window(values):
        return jnp.take_along_axis(jnp.asarray(values), index, 2)

    clipped = inside & (window(on) >= search.limits.saturation.astype(jnp.uint8))
    return Peak(
        place,
        inside,
        light=jnp.where(inside, window(light), 0.0),
        room=window(jnp.broadcast_to(room, lit.shape)),
        off=None if off is None else levels[window(off)],
        saturated=jnp.sum(clipped, axis=2).astype(jnp.uint8),
    )


def _measured(located: Peak, lamp_ratio: Array, search: Search, pitch: int) -> FrameStripes:
    """The stripes [1, lines]: one candidate of a line."""
    limits, light = search.limits, located.light
    variance = _variance(located, lamp_ratio, search)
    blurred = _blurred(light)
    top = blurred[:, :, _REACH, None]
    counts = _around_the_middle(located.inside[:, :, 1:-1] & (blurred > _SHARE * top))
    weight = jnp.where(counts, blurred - _SHARE * top, 0.0)
    total = jnp.sum(weight, axis=2, keepdims=True)
    total = jnp.where(total > 0, total, 1.0)
    x = jnp.arange(-_REACH, _REACH + 1, dtype=jnp.float32)[None, None, :]
    centre = jnp.sum(x * weight, axis=2, keepdims=True) / total
    # d centre / d blurred sample; the highest one moves the threshold too.
    pull = jnp.where(counts, x - centre, 0.0) / total
    pull = pull - jnp.where(x == 0, _SHARE * jnp.sum(pull, axis=2, keepdims=True), 0.0)
    of_sample = _blurred(jnp.pad(pull, ((0, 0), (0, 0), (2, 2))))
    sigma = pitch * jnp.sqrt(jnp.sum(of_sample**2 * variance, axis=2))
    lit = jnp.where(counts, light[:, :, 1:-1], 0.0)
    amplitude = jnp.max(lit, axis=2)
    width = pitch * jnp.sum(lit, axis=2) / (math.sqrt(2.0 * math.pi) * jnp.maximum(amplitude, 1e-3))
    samples_wide = jnp.maximum(width / pitch, 0.5)
    sigma = jnp.sqrt(sigma**2 + (pitch * _SAMPLING / samples_wide**2) ** 2)
    snr = jnp.maximum(top[:, :, 0], 0.0) / jnp.sqrt(sum(h * h for h in _BLUR) * variance[:, :, _REACH + 1])
    valid = (amplitude > 0) & (snr >= limits.least_snr) & (sigma <= limits.max_sigma)
    valid &= (width >= limits.min_width) & (width <= limits.max_width)
    grey = jnp.zeros_like(snr)
    if located.off is not None:
        nearest = jnp.round(centre).astype(jnp.int32) + _REACH + 1
        grey = jnp.take_along_axis(located.off, nearest, 2)[:, :, 0]
    nothing = jnp.zeros_like(snr)
    u = pitch * (located.place.astype(jnp.float32) + centre[:, :, 0])
    fields = u, sigma, amplitude, width, nothing, nothing, snr, grey, located.saturated, valid
    return jax.tree.map(lambda field: jnp.where(valid, field, jnp.zeros_like(field)), FrameStripes(*fields))


def _variance(located: Peak, ratio: Array, search: Search) -> Float[Array, "frames lines window"]:
    """Variance of the laser's light [DN^2]: of both frames, with the stripe's own shot noise and speckle."""
    frame = search.read_dn**2 + 1 / 12
    laser = jnp.maximum(located.light, 0.0)
    room = jnp.maximum(located.room - search.black_dn, 0.0)
    frame += (laser + room) / search.electrons_per_dn + (search.speckle * laser) ** 2
    if located.off is None:
        return frame
    dark = search.read_dn**2 + 1 / 12 + jnp.maximum(located.off - search.black_dn, 0.0) / search.electrons_per_dn
    return frame + ratio**2 * dark


def _blurred(values: Float[Array, "frames lines n"]) -> Float[Array, "frames lines n-2"]:
    """The samples but for the first and the last one, blurred."""
    return _BLUR[0] * (values[:, :, :-2] + values[:, :, 2:]) + _BLUR[1] * values[:, :, 1:-1]


def _around_the_middle(counts: Bool[Array, "frames lines n"]) -> Bool[Array, "frames lines n"]:
    """The samples that hang together with the middle one."""
    middle = counts.shape[2] // 2
    before = jnp.cumprod(counts[:, :, middle::-1], axis=2)[:, :, ::-1]
    after = jnp.cumprod(counts[:, :, middle:], axis=2)
    return jnp.concatenate([before[:, :, :-1], after], axis=2) > 0


def _median(on: Float[Array, "frames lines samples"], gate: Bool[Array, "1 lines samples"]) -> Array:
    """The median level of the part of every line that is searched [frames, lines, 1]; 0 where there is none."""
    count = jnp.sum(gate, axis=2, keepdims=True)
    place = jnp.broadcast_to(jnp.maximum(count - 1, 0) // 2, (*on.shape[:2], 1))
    median = jnp.take_along_axis(jnp.sort(jnp.where(gate, on, jnp.inf), axis=2), place, 2)
    return jnp.where(count > 0, median, 0.0)
