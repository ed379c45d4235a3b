"""The array type: JAX arrays inside compiled code, NumPy arrays on the host.

`Scanner` holds NumPy float64 on the host, so its precision does not depend on the 64-bit mode of JAX.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


Array = jax.Array | np.ndarray

MAX_PIXELS = 100_000_000
"""Largest image that is decoded, accepted from a header, or set on a camera."""


def real(value: Any) -> Array:
    """Numbers and lists as NumPy float64; JAX arrays and floating NumPy arrays as they are."""
    if isinstance(value, jax.Array):
        return value
    array = np.asarray(value)
    return array if np.issubdtype(array.dtype, np.floating) else array.astype(np.float64)


def functions_of(points: Array, *others: Array) -> Any:
    """The functions that compute with points: NumPy's, which compile nothing, for NumPy arrays of many; else JAX's."""
    many = isinstance(points, np.ndarray) and points.ndim > 1
    return np if many and all(isinstance(other, np.ndarray) for other in others) else jnp
