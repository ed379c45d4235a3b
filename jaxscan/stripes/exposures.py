"""One set of stripes from several exposures of the same record."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int8

from jaxscan.geometry import Array
from jaxscan.stripes.stripes import FrameStripes


def merge_exposures(
    stripes: FrameStripes,
    chosen: Int8[Array, "frames lines"] | None,
    exposures: tuple[float, ...],
    each: int,
) -> tuple[FrameStripes, Int8[Array, "records lines"] | None]:
    """For every line the exposure whose centre is known best, in levels of the first one; pure and traceable.

    That is the valid one of the smallest sigma; of equal ones the longest. A stripe that is saturated in a long
    exposure thus comes from a short one, and a faint one from a long one.

    Args:
        stripes: Profiles of all frames, the exposures of a record following each other.
        chosen: Number of the chosen candidate of every line, by which all candidates of the line are taken; None where
            nothing is chosen among several.
        exposures: Relative exposures of the frames of a record.
        each: Profiles of a frame.

    Raises:
        ValueError: If an exposure is not positive.
    """
    if not all(np.isfinite(one) and one > 0 for one in exposures):
        raise ValueError(f"Found the relative exposures {exposures}, expected positive numbers.")
    # [records * exposures * profiles, lines] to [exposures, records, profiles, lines].
    apart = lambda field, each: jnp.moveaxis(field.reshape(-1, len(exposures), each, field.shape[1]), 1, 0)
    split = jax.tree.map(lambda field: apart(field, each), stripes)
    scale = np.asarray([exposures[0] / one for one in exposures], np.float32)[:, None, None, None]
    split = split._replace(grey=split.grey * scale, amplitude=split.amplitude * scale)
    known, sigma, number = split.valid, split.sigma, None
    if chosen is not None:
        number = apart(chosen, 1)
        known, sigma = number >= 0, jnp.take_along_axis(sigma, jnp.maximum(number, 0).astype(jnp.int32), 2)
    # The longest first: an exposure has to be better than those before it, not just as good.
    order = np.argsort(-np.asarray(exposures), kind="stable").astype(np.int32)
    best = jnp.asarray(order)[jnp.argmin(jnp.where(known, sigma, jnp.inf)[order], 0)]
    best = jnp.where(jnp.any(known, 0), best, 0)[None]
    take = lambda field: jnp.take_along_axis(field, best, 0).reshape(-1, field.shape[3])
    return jax.tree.map(take, split), None if number is None else take(number)
