r"""How a stripe's centre is found on a line: by maximum likelihood ("gaussian"), or plainly ("centre_of_gravity").

The default locates maxima of two matched filters (`peaks`) and fits each with a pixel-integrated Gaussian (`fit`). The
plain estimator takes every line by itself. The difference of the pair (or, without laser-off frames, the frame above
the median of its line) is blurred by (1, 2, 1) / 4. Around the highest sample of a line the part that lies above a
fifth of it counts, with weights $w_i = \max(b_i - t, 0)$ that vanish at the threshold t:

$$u = \frac{\sum x_i w_i}{\sum w_i}, \qquad
  \sigma^2 = \sum_j v_j \left( \frac{\sum_i (x_i - u)\, h_{i-j}}{\sum_i w_i} \right)^2,$$

with the variance $v_j$ of a sample and the blur h. No width is assumed and nothing is fitted: skewed stripes and
reflections beside the stripe pull the centre, and clipping is not corrected.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.faint import Look
from jaxscan.stripes.fit import fit_peaks
from jaxscan.stripes.frames import Sites
from jaxscan.stripes.peaks import CANDIDATES, find_peaks
from jaxscan.stripes.planes import Plane
from jaxscan.stripes.search import Search
from jaxscan.stripes.stripes import Choice, FrameStripes, StripeSettings


_REACH = 16
"""Samples on either side of the highest one that may count."""
_SHARE = 0.2
"""Part of the highest sample below which light does not count [1]."""
_SAMPLING = 0.025
"""Error that sampling leaves in a stripe as wide as a sample [samples]; it falls with the square of the width."""
_BLUR = (0.25, 0.5, 0.25)


class Estimator(NamedTuple):
    """Finds and measures stripes; the engine learns, chooses among candidates, and puts them on the image's lines."""

    measure: Callable[[Plane, Plane | None, Array, Search, Sites, bool, Look | None], FrameStripes]
    """Candidates [candidates, lines of the plane] of one frame, zero where there is no stripe; pure and traceable. It
    takes the frame with the laser on and off, the factor by which light of the laser-off frame is multiplied, where to
    look and what is believed, where the plane lies in the image, whether codes are linear levels, and what it looks for
    where it looks twice."""
    candidates: int
    """Largest number of candidates of a line."""
    choices: tuple[Choice, ...]
    """Rules of choice that make sense of its candidates."""
    faint: bool
    """Whether it looks again, for faint stripes of lines on which none was found."""
    learns: bool
    """Whether the stripes of the first frames tell it width and speckle."""


def _gaussian(
    on: Plane, off: Plane | None, lamp_ratio: Array, search: Search, sites: Sites, linear: bool, look: Look | None
):
    pitch, lines = sites.pitch, {} if look is None else {"together": look.again, "wanted": look.lacking}
    peaks = find_peaks(on, off, lamp_ratio, search.low, search.high, search.thresholds, pitch=pitch, **lines)
    asked = search if look is None else look.search(search)
    found = fit_peaks(on, off, lamp_ratio, peaks, asked, pitch=pitch, linear=linear)
    return found if look is None else look.believed(found, peaks, search)


def _centre_of_gravity(
    on: Plane, off: Plane | None, lamp_ratio: Array, search: Search, sites: Sites, linear: bool, look: Look | None
):
    """The centre of gravity of the brightest place of every line, its standard deviation by propagation."""
    limits, levels, samples, pitch = search.limits, jnp.asarray(search.levels), on.samples.shape[1], sites.pitch
    number = jnp.arange(samples, dtype=jnp.int32)[None]
    low, high = jnp.asarray(search.low)[:, None], jnp.asarray(search.high)[:, None]
    gate = (number >= low) & (number < high)
    lit = levels[on.samples]
    room = _median(lit, gate) if off is None else lamp_ratio * levels[off.samples]
    light = jnp.where(gate, lit - room, -jnp.inf)
    place = jnp.argmax(_blurred(jnp.pad(light, ((0, 0), (1, 1)), mode="edge")), axis=1).astype(jnp.int32)
    index = place[:, None] + np.arange(-_REACH - 1, _REACH + 2, dtype=np.int32)[None]
    inside = (index >= low) & (index < high)
    window = lambda values: jnp.take_along_axis(jnp.asarray(values), jnp.clip(index, 0, samples - 1), 1)
    clipped = inside & (window(on.samples) >= limits.saturation.astype(jnp.uint8))
    light, room = jnp.where(inside, window(light), 0.0), window(jnp.broadcast_to(room, lit.shape))
    dark = None if off is None else levels[window(off.samples)]
    # Variance of the laser's light: of both frames, with the stripe's own shot noise and speckle.
    noise = lambda level: jnp.maximum(level - search.black_dn, 0.0) / search.electrons_per_dn
    laser, still = jnp.maximum(light, 0.0), search.read_dn**2 + 1 / 12
    variance = still + laser / search.electrons_per_dn + noise(room) + (search.speckle * laser) ** 2
    if dark is not None:
        variance += lamp_ratio**2 * (still + noise(dark))

    blurred = _blurred(light)
    top = blurred[:, _REACH, None]
    counts = inside[:, 1:-1] & (blurred > _SHARE * top)
    # Those that hang together with the middle one.
    before, after = (jnp.cumprod(side, axis=1) for side in (counts[:, _REACH::-1], counts[:, _REACH:]))
    counts = jnp.concatenate([before[:, :0:-1], after], axis=1) > 0
    weight = jnp.where(counts, blurred - _SHARE * top, 0.0)
    total = jnp.sum(weight, axis=1, keepdims=True)
    total = jnp.where(total > 0, total, 1.0)
    x = jnp.arange(-_REACH, _REACH + 1, dtype=jnp.float32)[None]
    centre = jnp.sum(x * weight, axis=1, keepdims=True) / total
    # d centre / d blurred sample; the highest one moves the threshold too.
    pull = jnp.where(counts, x - centre, 0.0) / total
    pull = pull - jnp.where(x == 0, _SHARE * jnp.sum(pull, axis=1, keepdims=True), 0.0)
    of_sample = _blurred(jnp.pad(pull, ((0, 0), (2, 2))))
    seen = jnp.where(counts, light[:, 1:-1], 0.0)
    amplitude = jnp.max(seen, axis=1)
    width = pitch * jnp.sum(seen, axis=1) / (math.sqrt(2.0 * math.pi) * jnp.maximum(amplitude, 1e-3))
    sampling = pitch * _SAMPLING / jnp.maximum(width / pitch, 0.5) ** 2
    sigma = jnp.sqrt(pitch**2 * jnp.sum(of_sample**2 * variance, axis=1) + sampling**2)
    snr = jnp.maximum(top[:, 0], 0.0) / jnp.sqrt(sum(h * h for h in _BLUR) * variance[:, _REACH + 1])
    valid = (amplitude > 0) & (snr >= limits.least_snr) & (sigma <= limits.max_sigma_px)
    valid &= (width >= limits.min_width_px) & (width <= limits.max_width_px)
    nothing = jnp.zeros_like(snr)
    nearest = jnp.round(centre).astype(jnp.int32) + _REACH + 1
    grey = nothing if dark is None else jnp.take_along_axis(dark, nearest, 1)[:, 0]
    u, saturated = pitch * (place.astype(jnp.float32) + centre[:, 0]), jnp.sum(clipped, axis=1).astype(jnp.uint8)
    found = FrameStripes(u, sigma, amplitude, width, nothing, nothing, snr, grey, saturated, valid)
    return jax.tree.map(lambda field: jnp.where(valid, field, jnp.zeros_like(field))[None], found)


def _blurred(values: Float[Array, "lines n"]) -> Float[Array, "lines n-2"]:
    """The samples without the first and the last one, blurred."""
    return _BLUR[0] * (values[:, :-2] + values[:, 2:]) + _BLUR[1] * values[:, 1:-1]


def _median(on: Float[Array, "lines samples"], gate: Array) -> Array:
    """The median level of the part of every line that is searched [lines, 1]; 0 where there is none."""
    count = jnp.sum(gate, axis=1, keepdims=True)
    median = jnp.take_along_axis(jnp.sort(jnp.where(gate, on, jnp.inf), axis=1), jnp.maximum(count - 1, 0) // 2, 1)
    return jnp.where(count > 0, median, 0.0)


ESTIMATORS = {
    "gaussian": Estimator(
        _gaussian, CANDIDATES, ("path", "brightest", "nearest", "farthest", "all"), faint=True, learns=True
    ),
    "centre_of_gravity": Estimator(_centre_of_gravity, 1, ("path", "brightest"), faint=False, learns=False),
}
"""All estimators, by the names that settings and the command line have for them."""


def estimator_of(settings: StripeSettings) -> Estimator:
    """The estimator that the settings name.

    Raises:
        ValueError: If there is none of this name, or it cannot choose as the settings ask.
    """
    found = ESTIMATORS.get(settings.estimator)
    if found is None:
        raise ValueError(f"Unknown estimator {settings.estimator!r}; known: {', '.join(ESTIMATORS)}.")
    if settings.choice not in found.choices:
        raise ValueError(
            f'The estimator "{settings.estimator}" cannot choose "{settings.choice}", only '
            f"{', '.join(found.choices)}; take another choice, or another estimator."
        )
    return found
