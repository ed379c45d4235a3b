"""Which candidate of each line is the stripe."""

import jax.numpy as jnp
from jaxtyping import Float, Int8

from jaxscan.geometry import Array
from jaxscan.stripes.choosing.path import best_path
from jaxscan.stripes.stripes import FrameStripes, StripeSettings


def choose(
    candidates: FrameStripes, near_side: Float[Array, ""] | float, settings: StripeSettings
) -> Int8[Array, "frames lines"]:
    """The number of each line's candidate by `settings.choice` ("all" is not a choice), or -1.

    Args:
        candidates: The candidates of every line.
        near_side: +1 where the nearer of two stripes has the larger centre, else -1.
        settings: The rule, and the signal-to-noise ratios that it asks for.
    """
    if settings.choice == "path":
        return best_path(candidates, alone_snr=settings.min_snr, continued_snr=settings.continued_snr)
    u = candidates.u
    rank = {"brightest": candidates.amplitude, "nearest": near_side * u, "farthest": -near_side * u}[settings.choice]
    rank = jnp.where(candidates.valid & (candidates.snr >= settings.min_snr), rank, -jnp.inf)
    best = jnp.argmax(rank, axis=2).astype(jnp.int8)
    return jnp.where(jnp.any(jnp.isfinite(rank), axis=2), best, jnp.int8(-1))
