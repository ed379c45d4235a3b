"""All candidates of a chunk fitted and judged, block by block."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.fitting.accept import accept
from jaxscan.stripes.fitting.albedo import albedo_shift
from jaxscan.stripes.fitting.fit import fit_stripe, sample_places
from jaxscan.stripes.fitting.window import prepare_window
from jaxscan.stripes.frames.formats import Response
from jaxscan.stripes.search.candidates import BLOCK, Candidates
from jaxscan.stripes.stripes import StripeSettings


_REST = 0.05
"""Error in standard deviations with which a fit may end early; it adds 0.25 % to the variance."""


class Fits(NamedTuple):
    """Fitted candidates, in the order of their lists."""

    u: Float[Array, " fits"]
    """Centre, from the line's first sample [px]."""
    sigma: Float[Array, " fits"]
    """Standard deviation of `u` [px]."""
    amplitude: Float[Array, " fits"]
    """Peak of the Gaussian [DN]."""
    width: Float[Array, " fits"]
    """Standard deviation of the Gaussian [px]."""
    chi2: Float[Array, " fits"]
    """Chi-squared per degree of freedom [1]."""
    skew: Float[Array, " fits"]
    """Skewness [1]."""
    snr: Float[Array, " fits"]
    """Signal-to-noise ratio of the whole stripe [1]."""
    grey: Float[Array, " fits"]
    """Level of the laser-off frame at the centre [DN]; 0 without one."""
    saturated: UInt8[Array, " fits"]
    """Number of saturated pixels."""
    valid: Bool[Array, " fits"]
    """Whether it may be a stripe at all."""


def fit_candidates(
    lists: tuple[Candidates, ...],
    gain: Float[Array, " frames"],
    noise_read: Float[Array, ""],
    noise_gain: Float[Array, ""],
    prior: tuple[Float[Array, ""], Float[Array, ""]],
    *,
    samples: int,
    pitch: int,
    response: Response,
    settings: StripeSettings,
) -> Fits:
    """Fit every candidate of all lists.

    Args:
        lists: The candidates; blocks without any are not looked at.
        gain: By what the light of each frame's laser-off image is multiplied.
        noise_read: Read noise of one frame [DN].
        noise_gain: Conversion gain [e-/DN].
        prior: What is known of the width, as `fit_stripe` takes it.
        samples: Samples of a whole line.
        pitch: Distance between them [px].
        response: "linear" or "srgb".
        settings: How stripes are fitted and judged.
    """

    def fit(block: Candidates, number: Array) -> Fits:
        return _fit_block(
            block, number, gain, noise_read, noise_gain, prior, samples=samples, pitch=pitch, response=response,
            settings=settings,
        )  # fmt: skip

    def fit_list(found: Candidates) -> Fits:
        blocks, size = found.start.shape

        def block(number):
            return jax.tree.map(lambda field: field if field.ndim == 0 else field[number], found)

        if blocks == 1:
            return fit(block(0), jnp.int32(0))
        shapes = jax.eval_shape(fit, block(0), jnp.int32(0))
        nothing = jax.tree.map(lambda field: jnp.zeros((blocks, size), field.dtype), shapes)

        def put(number, fits):
            return jax.tree.map(lambda field, part: field.at[number].set(part), fits, fit(block(number), number))

        filled = lax.fori_loop(0, -(-found.total // BLOCK), put, nothing)
        return jax.tree.map(jnp.ravel, filled)

    parts = [fit_list(found) for found in lists]
    return jax.tree.map(lambda *fields: jnp.concatenate(fields), *parts) if len(parts) > 1 else parts[0]


def _fit_block(
    block: Candidates,
    number: Array,
    gain: Array,
    noise_read: Array,
    noise_gain: Array,
    prior: tuple[Array, Array],
    *,
    samples: int,
    pitch: int,
    response: Response,
    settings: StripeSettings,
) -> Fits:
    size = block.start.shape[0]
    real = number * size + jnp.arange(size, dtype=jnp.int32) < block.total
    own_gain = gain[jnp.where(real, block.frame, 0)]
    window, start = prepare_window(block, pitch, noise_read, noise_gain, own_gain, response, settings)
    least = settings.continued_snr if settings.choice == "path" else settings.min_snr
    fit = fit_stripe(
        window,
        start,
        iterations=jnp.where(block.saturated > 0, settings.clipped_iterations, settings.iterations),
        max_width=1.1 * settings.max_width_px,
        active=real,
        prior=prior,
        speckle=settings.speckle,
        min_snr=least,
        rest=_REST,
    )
    valid, sigma, chi2 = accept(
        fit,
        reach=0.5 * block.on.shape[0] * window.step,
        tallest=jnp.where(block.saturated > 0, jnp.inf, 2.0 * start.amplitude),
        parameters=3 if block.off is not None else 4,
        least_snr=least,
        settings=settings,
    )
    u = block.middle + fit.u
    valid &= real & (u >= -0.5) & (u <= pitch * (samples - 1) + 0.5)
    grey = jnp.zeros_like(u)
    place = jnp.asarray(sample_places(block.on.shape[0]))[:, None]
    if block.off is not None:
        grey = jnp.sum(jnp.maximum(1.0 - jnp.abs(place - (fit.u / window.step)[None, :]), 0.0) * block.off, 0)
    if block.off is not None and settings.guard_edges:
        # What an edge of the surface's reflectance under the stripe may have done to the centre.
        dark = (noise_read * noise_read + 1 / 12 + block.off / noise_gain) / window.step[None, :]
        edge = albedo_shift(block.off, place * window.step[None, :], fit.u, fit.width, block.on >= 0.0, dark)
        sigma = jnp.sqrt(sigma * sigma + edge.shift * edge.shift)
    snr = jnp.sqrt(jnp.maximum(fit.energy, 0.0))
    found = Fits(
        u, sigma, fit.amplitude, fit.width, chi2, fit.skew, snr, grey, block.saturated.astype(jnp.uint8), valid
    )
    return jax.tree.map(lambda field: jnp.where(valid, field, jnp.zeros_like(field)), found)
