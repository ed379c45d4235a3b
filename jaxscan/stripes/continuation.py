"""The work that follows the stripes of a chunk: exposures or channels merged, then colours and points."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int8

from jaxscan.geometry import Array
from jaxscan.stripes.estimators import estimator_of
from jaxscan.stripes.exposures import merge_brackets
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes


class ChunkStripes(NamedTuple):
    """Stripes of a chunk of records."""

    stripes: FrameStripes
    chosen: Int8[Array, "records lines"] | None
    """Of several candidates of every line the number of the stripe, -1 for none; None where one is given."""
    more: Any
    """The result of the continuation."""


class Continuation(eqx.Module):
    """Work that is compiled together with the extraction."""

    function: Callable[[FrameStripes, Array | None, Any, Any, ExtractionSetup], Any] = eqx.field(static=True)
    """Takes the stripes, the laser-off frames, both operands and the setup; pure and traceable."""
    shared: Any = None
    """Arrays that all records share."""
    per_record: Any = None
    """Arrays with a leading axis over records."""
    needs_frames: bool = eqx.field(static=True, default=False)
    """Whether `function` looks at the laser-off frames."""
    records: int = eqx.field(static=True, default=0)
    """Records that it is compiled for: fewer are filled up with black ones; as many as there are if 0."""


NOTHING_MORE = Continuation(lambda *_: None)


def padded(array: Array, size: int) -> Array:
    """The array, filled up with zeros to `size` entries."""
    if len(array) >= size:
        return array
    array = np.asarray(array)
    whole = np.zeros((size, *array.shape[1:]), array.dtype)
    whole[: len(array)] = array
    return whole


def continue_stripes(
    stripes: FrameStripes, chosen: Array | None, off: Array | None, then: Continuation, setup: ExtractionSetup
) -> ChunkStripes:
    """Merge exposures, continue; pure and traceable."""
    if len(setup.exposures) > 1:
        each = estimator_of(setup.settings).candidates if setup.several else 1
        stripes, chosen = merge_brackets(stripes, chosen, setup.exposures, each)
        # The longest exposure shows the dark parts best.
        off = None if off is None else off[len(setup.exposures) - 1 :: len(setup.exposures)]
    return ChunkStripes(stripes, chosen, then.function(stripes, off, then.shared, then.per_record, setup))


def merge_channels(
    parts: list[tuple[FrameStripes, Array | None]],
    off: Array | None,
    then: Continuation,
    setup: ExtractionSetup,
    responses: tuple[float, ...],
) -> ChunkStripes:
    """Channels chosen like exposures, amplitudes as the first one sees them, and the continuation."""
    each = estimator_of(setup.settings).candidates if setup.several else 1

    def together(fields, each):
        # [channels][records * each, lines] to [records * channels * each, lines].
        lines = fields[0].shape[1]
        return jnp.stack([field.reshape(-1, each, lines) for field in fields], 1).reshape(-1, lines)

    stripes = jax.tree.map(lambda *fields: together(fields, each), *(one for one, _ in parts))
    numbers = [number for _, number in parts if number is not None]
    merged, chosen = merge_brackets(stripes, together(numbers, 1) if numbers else None, responses, each)
    if off is not None and len(setup.exposures) > 1:
        off = off[:, -1]
    return ChunkStripes(merged, chosen, then.function(merged, off, then.shared, then.per_record, setup))
