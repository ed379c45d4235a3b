"""Which candidate of each line is the stripe."""

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int8

from jaxscan.geometry import Array
from jaxscan.stripes.choosing.path import best_path
from jaxscan.stripes.stripes import StripeSettings


def choose(
    u: Float[Array, "frames lines k"],
    snr: Float[Array, "frames lines k"],
    amplitude: Float[Array, "frames lines k"],
    width: Float[Array, "frames lines k"],
    valid: Bool[Array, "frames lines k"],
    near_side: Float[Array, ""] | float,
    settings: StripeSettings,
) -> Int8[Array, "frames lines"]:
    """The number of each line's candidate by `settings.choice` ("all" is not a choice), or -1.

    Args:
        u: Centres [px].
        snr: Signal-to-noise ratios [1].
        amplitude: Amplitudes [DN].
        width: Standard deviations [px].
        valid: Which candidates are believed at all.
        near_side: +1 where what is nearer has the larger centre, else -1.
        settings: The rule, and the signal-to-noise ratios that it asks for.
    """
    if settings.choice == "path":
        return best_path(
            u, snr, amplitude, width, valid, alone_snr=settings.min_snr, continued_snr=settings.continued_snr
        )
    rank = {"brightest": amplitude, "nearest": near_side * u, "farthest": -near_side * u}[settings.choice]
    rank = jnp.where(valid & (snr >= settings.min_snr), rank, -jnp.inf)
    best = jnp.argmax(rank, axis=2).astype(jnp.int8)
    return jnp.where(jnp.any(jnp.isfinite(rank), axis=2), best, jnp.int8(-1))
