"""The array type of the house: JAX arrays inside compiled code, NumPy arrays on the host.

`Scanner` holds NumPy float64 on the host, so that its precision does not depend on whether
the caller enabled 64-bit JAX.
"""

from typing import Any

import jax
import numpy as np


Array = jax.Array | np.ndarray

MAX_PIXELS = 100_000_000
"""Largest image that is decoded, announced by a file or asked of a camera."""


def real(value: Any) -> Array:
    """Numbers and lists as NumPy float64; JAX arrays and floating NumPy arrays as they are."""
    if isinstance(value, jax.Array):
        return value
    array = np.asarray(value)
    return array if np.issubdtype(array.dtype, np.floating) else array.astype(np.float64)
