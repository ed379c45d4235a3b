"""One set of stripes from several exposures of the same record."""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Array


S = TypeVar("S")


def merge_exposures(stripes: S, relative: Float[Array, " exposures"] | tuple[float, ...]) -> S:
    """For every line the exposure whose centre is known best.

    That is the valid one of the smallest sigma; of equal ones the longest. A stripe that is saturated in a
    long exposure thus comes from a short one, and a faint one from a long one.

    Args:
        stripes: NamedTuple or dict of arrays [exposures, ...] with at least `sigma`, `valid` and
            `amplitude`; all fields are chosen alike.
        relative: Relative exposure of each [1].

    Returns:
        The same without the leading axis; amplitudes are what the first exposure would have seen
        [DN of that exposure]. Lines that no exposure holds are zero.

    Raises:
        ValueError: If the exposures are not as many as the arrays say, or not all positive.
    """
    names = dict(stripes) if isinstance(stripes, dict) else stripes._asdict()  # type: ignore[attr-defined]
    factor = np.asarray(relative, np.float64)
    count = len(names["valid"])
    if factor.shape != (count,) or not np.all(np.isfinite(factor) & (factor > 0)):
        raise ValueError(f"{count} exposures need as many positive relative exposures, got {relative}.")
    names["amplitude"] = jnp.stack(
        [names["amplitude"][i] * np.asarray(factor[0] / factor[i], names["amplitude"].dtype) for i in range(count)]
    )
    # The longest first: an exposure has to be better than those before it, not just as good.
    order = [int(i) for i in np.argsort(-factor, kind="stable")]
    exposures = [jax.tree.map(lambda field, i=i: field[i], names) for i in order]
    best = exposures[0]
    for other in exposures[1:]:
        better = other["valid"] & (~best["valid"] | (other["sigma"] < best["sigma"]))
        best = jax.tree.map(lambda new, old, better=better: jnp.where(better, new, old), other, best)
    best = jax.tree.map(lambda field: jnp.where(best["valid"], field, jnp.zeros_like(field)), best)
    return best if isinstance(stripes, dict) else type(stripes)(**best)
