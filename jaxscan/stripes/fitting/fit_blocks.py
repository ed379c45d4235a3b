"""All candidates of a chunk fitted and judged, block by block."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.fitting.accept import accept
from jaxscan.stripes.fitting.albedo import DarkWindow, albedo_shift
from jaxscan.stripes.fitting.gaussian_fit import FitRules, fit_stripe, sample_places
from jaxscan.stripes.fitting.window import prepare_window
from jaxscan.stripes.search import Candidates, Search
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes


REST = 0.05
"""Error in standard deviations with which a fit may end early; it adds 0.25 % to the variance."""


def fit_candidates(
    lists: tuple[Candidates, ...], lamp_ratio: Float[Array, " frames"], search: Search, setup: ExtractionSetup
) -> FrameStripes:
    """Fit every candidate of all lists.

    Args:
        lists: The candidates; blocks without any are not looked at.
        lamp_ratio: Factor by which the light of each frame's laser-off image is multiplied.
        search: The noise, and the prior of the width.
        setup: Frames, laser and settings.
    """

    def fit(block: Candidates, number: Array) -> FrameStripes:
        return _fit_block(block, number, lamp_ratio, search, setup)

    def fit_list(found: Candidates) -> FrameStripes:
        blocks, size = found.start.shape

        def block(number):
            return jax.tree.map(lambda field: field if field.ndim == 0 else field[number], found)

        if blocks == 1:
            return fit(block(0), jnp.int32(0))
        shapes = jax.eval_shape(fit, block(0), jnp.int32(0))
        nothing = jax.tree.map(lambda field: jnp.zeros((blocks, size), field.dtype), shapes)

        def put(number, fits):
            return jax.tree.map(lambda field, part: field.at[number].set(part), fits, fit(block(number), number))

        filled = lax.fori_loop(0, -(-found.total // size), put, nothing)
        return jax.tree.map(jnp.ravel, filled)

    parts = [fit_list(found) for found in lists]
    return jax.tree.map(lambda *fields: jnp.concatenate(fields), *parts) if len(parts) > 1 else parts[0]


def _fit_block(
    block: Candidates, number: Array, lamp_ratio: Array, search: Search, setup: ExtractionSetup
) -> FrameStripes:
    settings, pitch, samples = setup.settings, setup.sites.pitch, setup.plane_size[1]
    size = block.start.shape[0]
    real = number * size + jnp.arange(size, dtype=jnp.int32) < block.total
    ratio = lamp_ratio[jnp.where(real, block.frame, 0)]
    window, start = prepare_window(block, ratio, search, setup)
    rules = FitRules(
        max_width=1.1 * settings.max_width_px,
        prior=(search.log_width, search.width_information),
        speckle=search.speckle * lax.rsqrt(block.bins.astype(jnp.float32)),
        min_snr=settings.least_snr,
        rest=REST,
    )
    iterations = jnp.where(block.saturated > 0, settings.clipped_iterations, settings.iterations)
    fit = fit_stripe(window, start, rules, iterations=iterations, active=real)
    valid, sigma, chi2 = accept(
        fit,
        reach=0.5 * block.on.shape[0] * window.step,
        tallest=jnp.where(block.saturated > 0, jnp.inf, 2.0 * start.amplitude),
        parameters=3 if block.off is not None else 4,
        settings=settings,
    )
    u = block.middle + fit.u
    valid &= real & (u >= -0.5) & (u <= pitch * (samples - 1) + 0.5)
    grey = jnp.zeros_like(u)
    place = jnp.asarray(sample_places(block.on.shape[0]))[:, None]
    if block.off is not None:
        grey = jnp.sum(jnp.maximum(1.0 - jnp.abs(place - (fit.u / window.step)[None, :]), 0.0) * block.off, 0)
    if block.off is not None and settings.guard_edges:
        # An edge of the surface's reflectance under the stripe may have moved the centre.
        light = jnp.maximum(block.off - search.black_dn, 0.0)
        variance = search.read_dn * search.read_dn + 1 / 12 + light / search.electrons_per_dn
        step = window.step[None, :]
        dark = DarkWindow(block.off, place * step, block.on >= 0.0, variance / step)
        edge = albedo_shift(dark, fit.u, fit.width, offset=search.black_dn)
        sigma = jnp.sqrt(sigma * sigma + edge.shift * edge.shift)
    snr = jnp.sqrt(jnp.maximum(fit.energy, 0.0))
    found = FrameStripes(
        u, sigma, fit.amplitude, fit.width, chi2, fit.skew, snr, grey, block.saturated.astype(jnp.uint8), valid
    )
    return jax.tree.map(lambda field: jnp.where(valid, field, jnp.zeros_like(field)), found)
