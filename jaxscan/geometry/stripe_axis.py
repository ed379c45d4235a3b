"""The lines of a stripe: image rows or image columns."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from jaxscan.geometry.arrays import Array


StripeAxis = Literal["rows", "columns"]
"""One stripe centre per image row ("rows"), or per image column ("columns")."""


def stripe_pixel(
    u: Shaped[Array | np.number, "*shape"], line: Shaped[Array | np.number, "*shape"], stripe_axis: StripeAxis
) -> Float[Array, "*shape 2"]:
    """Pixel of a stripe centre.

    Args:
        u: Coordinate across the line [px].
        line: Number of the line: image row, or image column for `stripe_axis` "columns" [px].
        stripe_axis: Whether a line is an image row or an image column.

    Returns:
        q = (column, row) [px]; a NumPy array where `u` and `line` are.
    """
    xp = jnp if any(isinstance(a, jnp.ndarray) for a in (u, line)) else np
    return xp.stack([u, line] if stripe_axis == "rows" else [line, u], -1)


def across_and_along(width: int, height: int, stripe_axis: StripeAxis) -> tuple[int, int]:
    """Length of a line, and the number of lines, of an image of this size [px]."""
    return (width, height) if stripe_axis == "rows" else (height, width)
