"""Hints on memory for XLA's code for a CPU: which results are kept, and that only what exists is computed."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Int


Array = jax.Array | np.ndarray
_BLOCK = 256
"""Entries that are computed together."""
_ROW = 64
"""Entries that one row of a product counts."""


def kept(some: Bool[Array, ""], make: Callable[..., Any], *fields: Any) -> Any:
    """`make(*fields)`, or zeros where not `some`: what comes out of a branch is kept in memory.

    Else it would be computed again for each neighbour that looks at it, and for each of several results. `some` must
    not be known before the program runs.
    """
    # Compiled, so that it is traced once, for its shapes and for the branch.
    once = jax.jit(make, inline=True)
    nothing = jax.tree.map(lambda field: jnp.zeros(field.shape, field.dtype), jax.eval_shape(once, *fields))
    return lax.cond(some, once, lambda *_: nothing, *fields)


def folded(operation: Callable[[Array, Array], Array], rows: Array) -> Array:
    """All rows folded into one, by an operation on two rows. XLA itself reduces a leading axis in slow loops."""
    odd: list[Array] = []
    while len(rows) > 1:
        half = len(rows) // 2
        odd += [rows[-1:]] * (len(rows) % 2)
        rows = operation(rows[:half], rows[half : 2 * half])
    return functools.reduce(operation, odd, rows)[0]


def in_blocks(exists: Bool[Array, " n"], make: Callable[[Array, Array], Any]) -> Any:
    """Fields of those that exist, computed in blocks in which they lie one after the other.

    Args:
        exists: Which of n do.
        make: Gives arrays [block] for the numbers of a block's entries and for which of them are real.

    Returns:
        Arrays [n], zero where nothing exists.
    """
    places, total, number = _packed(exists)
    blocks = len(places) // _BLOCK

    def cut(k: Array) -> tuple[Array, Array]:
        real = k * _BLOCK + jnp.arange(_BLOCK, dtype=jnp.int32) < total
        return lax.dynamic_slice_in_dim(places, k * _BLOCK, _BLOCK), real

    def block(k: Array, found: Any) -> Any:
        put = lambda all, one: lax.dynamic_update_slice_in_dim(all, one, k * _BLOCK, 0)
        return jax.tree.map(put, found, make(*cut(k)))

    shapes = jax.eval_shape(lambda: make(*cut(jnp.int32(0))))
    nothing = jax.tree.map(lambda one: jnp.zeros(blocks * _BLOCK, one.dtype), shapes)
    found = lax.fori_loop(0, -(-total // _BLOCK), block, nothing)
    back = jnp.maximum(number, 0)
    unpacked = lambda field: jnp.where(exists, field.at[back].get(mode="promise_in_bounds"), field.dtype.type(0))
    return kept(total > 0, lambda found: jax.tree.map(unpacked, found), found)


def _packed(exists: Bool[Array, " n"]) -> tuple[Int[Array, " m"], Int[Array, ""], Int[Array, " n"]]:
    """Places of those that exist one after the other, filled up to whole blocks with the first place; their number; and
    for every place where it went, -1 for none. Counting begins with a small product in place of a long sum."""
    count = exists.size
    room = -(-count // _BLOCK) * _BLOCK
    whole = jnp.pad(exists, (0, -count % _ROW)).reshape(-1, _ROW).astype(jnp.float32)
    within = whole @ jnp.asarray(np.triu(np.ones((_ROW, _ROW), np.float32), 1))
    rows = jnp.sum(whole, 1)
    before = jnp.cumsum(rows) - rows
    number = (within + before[:, None]).reshape(-1)[:count].astype(jnp.int32)
    places = jnp.zeros(room, jnp.int32)
    places = places.at[jnp.where(exists, number, room)].set(jnp.arange(count, dtype=jnp.int32), mode="drop")
    return places, jnp.sum(rows).astype(jnp.int32), jnp.where(exists, number, -1)
