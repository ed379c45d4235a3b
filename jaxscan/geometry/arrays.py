"""The array type: JAX arrays inside compiled code, NumPy arrays on the host.

The geometry is written once for both, in the functions of a `namespace`. A scanner's arrays are NumPy float64 on the
host, so its precision does not depend on the 64-bit mode of JAX.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np


Array = jax.Array | np.ndarray
Component = jax.Array | np.ndarray | np.floating
"""One coordinate of points; for a single point NumPy gives a number."""

MAX_PIXELS = 100_000_000
"""Largest image that is decoded, accepted from a header, or set on a camera."""


class ArrayModule(eqx.Module):
    """A module whose methods are plain methods of Python.

    equinox makes each method a tree at each access, for a tenth of a millisecond: more than most of them compute on the
    host. None of these is handed to `jax.jit` by itself.
    """

    __getattribute__ = object.__getattribute__


def real(value: Any) -> Array:
    """Numbers and lists as NumPy float64; JAX arrays and floating NumPy arrays as they are."""
    if isinstance(value, jax.Array):
        return value
    array = np.asarray(value)
    return array if np.issubdtype(array.dtype, np.floating) else array.astype(np.float64)


def namespace(*trees: Any) -> Any:
    """The functions to compute with: JAX's where any leaf is a JAX array, else NumPy's, which compile nothing."""
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(trees)) else np


def solve_by_newton(
    xp: Any, closer: Callable[[Any, Any], Any], newton: Callable[[Any, Any], Any], start: Any, parameters: Any
) -> Any:
    """The root that Newton's method finds from `start`: arrays by name of coordinate.

    The last step alone carries derivatives. At the solution it is the implicit function theorem, so they are exact,
    and as small to compile as one step.

    Args:
        xp: The namespace.
        closer: A damped step: the next point from the point and the parameters.
        newton: A full step.
        start: The first point, a tuple of arrays.
        parameters: What the root depends on.
    """
    # A start with four correct digits has seven after one step, and sixteen after two.
    rounds = 4 if start[0].dtype == np.float32 else 12
    if xp is np:
        # It ends when steps are below rounding. Steps are clamped, since far outside an image there is no root.
        with np.errstate(all="ignore"):
            for _ in range(rounds):
                before, start = start, closer(start, parameters)
                if all(np.max(np.abs(b - a), initial=0.0) < 1e-9 for a, b in zip(before, start, strict=True)):
                    break
            return newton(start, parameters)
    fixed, start = jax.lax.stop_gradient((parameters, start))
    found = jax.lax.fori_loop(0, rounds, lambda _, point: closer(point, fixed), start)
    return newton(jax.lax.stop_gradient(found), parameters)
