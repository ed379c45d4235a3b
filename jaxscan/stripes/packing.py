"""The few of many that are to be looked at, one after the other in blocks: what is not there then costs nothing."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from jaxscan.geometry import Array


_ROW = 64
"""Entries that one row of a product counts."""


def packed(exists: Bool[Array, " n"], block: int) -> tuple[Int[Array, " m"], Int[Array, ""], Int[Array, " n"]]:
    """Places of those that exist one after the other, filled up to whole blocks with the first place; their number; and
    for every place where it went, -1 for none. Counting begins with a small product in place of a long sum."""
    count = exists.size
    room = -(-count // block) * block
    whole = jnp.pad(exists, (0, -count % _ROW)).reshape(-1, _ROW).astype(jnp.float32)
    within = whole @ jnp.asarray(np.triu(np.ones((_ROW, _ROW), np.float32), 1))
    rows = jnp.sum(whole, 1)
    before = jnp.cumsum(rows) - rows
    number = (within + before[:, None]).reshape(-1)[:count].astype(jnp.int32)
    places = jnp.zeros(room, jnp.int32)
    places = places.at[jnp.where(exists, number, room)].set(jnp.arange(count, dtype=jnp.int32), mode="drop")
    return places, jnp.sum(rows).astype(jnp.int32), jnp.where(exists, number, -1)
