"""One set of stripes from several exposures of the same record."""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int8

from jaxscan.geometry import Array
from jaxscan.stripes.stripes import FrameStripes


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
        The same without the leading axis; amplitudes are those that the first exposure would have
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


def merge_brackets(
    stripes: FrameStripes,
    chosen: Int8[Array, "frames lines"] | None,
    exposures: tuple[float, ...],
    each: int,
) -> tuple[FrameStripes, Int8[Array, "records lines"] | None]:
    """The best exposure of every line, in levels of the first one; pure and traceable.

    Args:
        stripes: Profiles of all frames, the exposures of a record following each other.
        chosen: Number of the chosen candidate of every line; None where nothing is chosen among several.
        exposures: Relative exposures of the frames of a record.
        each: Profiles of a frame.
    """
    count = len(exposures)

    def apart(values):
        # [records * exposures * profiles, lines] to [exposures, records, profiles, lines].
        return jnp.moveaxis(values.reshape(-1, count, each, values.shape[1]), 1, 0)

    def together(values):
        return values.reshape(-1, values.shape[2])

    split = jax.tree.map(apart, stripes)
    scale = np.asarray([exposures[0] / one for one in exposures], np.float32)[:, None, None, None]
    split = split._replace(grey=split.grey * scale)
    if chosen is None:
        return jax.tree.map(together, merge_exposures(split, exposures)), None
    # The exposure whose chosen stripe is known best gives all candidates of its line.
    number = jnp.moveaxis(chosen.reshape(-1, count, chosen.shape[1]), 1, 0)
    known = number >= 0

    def of_chosen(values):
        return jnp.take_along_axis(values, jnp.maximum(number, 0).astype(jnp.int32)[:, :, None], 2)[:, :, 0]

    fields = {name: of_chosen(getattr(split, name)) for name in ("sigma", "amplitude")}
    which = jnp.broadcast_to(jnp.arange(count, dtype=jnp.int32)[:, None, None], known.shape)
    best = merge_exposures({**fields, "valid": known, "which": which, "number": number}, exposures)
    split = split._replace(amplitude=split.amplitude * scale)
    merged = jax.tree.map(lambda values: jnp.take_along_axis(values, best["which"][None, :, None], 0)[0], split)
    return jax.tree.map(together, merged), jnp.where(best["valid"], best["number"], jnp.int8(-1))
