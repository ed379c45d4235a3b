"""Which fits are believed."""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxscan.geometry import Array
from jaxscan.stripes.fitting.gaussian_fit import Fit
from jaxscan.stripes.stripes import StripeSettings


def accept(
    fit: Fit,
    *,
    reach: Float[Array, " stripes"],
    tallest: Float[Array, " stripes"],
    parameters: int,
    settings: StripeSettings,
) -> tuple[Bool[Array, " stripes"], Float[Array, " stripes"], Float[Array, " stripes"]]:
    """Judge every fit.

    A stripe is believed if it stands out of the noise, its width is possible, its fit came to
    rest inside the window, and its residuals are noise or a small part of
    the stripe itself (real profiles are not Gaussian).

    Args:
        fit: The fits.
        reach: Half of each window [px].
        tallest: Largest amplitude that the samples allow [DN]: one side of an edge is no top of
            a hill that lies mostly below the ground.
        parameters: Number of fitted parameters.
        settings: Limits.

    Returns:
        valid: Which fits are believed.
        sigma: Standard deviation of the centre [px], grown by the misfit where chi-squared is
            too large for noise.
        chi2: Chi-squared per degree of freedom [1].
    """
    freedom = jnp.maximum(fit.samples - parameters, 1.0)
    chi2 = fit.chi2 / freedom
    expected = 1.0 + 3.0 * jnp.sqrt(2.0 / freedom)
    sigma = jnp.sqrt(fit.variance * jnp.maximum(chi2 / expected, 1.0))
    explained = fit.chi2 <= settings.max_chi2 * freedom + settings.max_misfit**2 * fit.energy
    valid = (
        (fit.samples > parameters)
        & (fit.energy >= settings.least_snr**2)
        & (fit.variance > 0)
        & (sigma <= settings.max_sigma_px)
        & (fit.width >= settings.min_width_px)
        & (fit.width <= settings.max_width_px)
        & (fit.amplitude <= tallest)
        & (fit.last_step <= 0.02 + sigma)
        & (jnp.abs(fit.u) <= reach)
        & explained
    )
    return valid, sigma, chi2
