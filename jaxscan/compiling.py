"""Compiles with little optimisation the functions that run a few times, where compiling would be most of the time."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax


_P, _R = ParamSpec("_P"), TypeVar("_R")
# Of a joint solve they take three quarters off the time of compiling, and add a half to that of a run.
_QUICKLY: dict[str, Any] = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


def compile_quickly(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """As `equinox.filter_jit`, but on a CPU compiled in a fraction of the time, to code that is somewhat slower.

    For functions that run a few times in a process, and are called by the host: not inside of another compiled
    function, where JAX takes no such options. Accelerators compile as ever.
    """

    @functools.cache
    def compiled() -> Callable[_P, _R]:
        # Asked at the first call: asking chooses the device, which is not for an import to do.
        options = _QUICKLY if jax.default_backend() == "cpu" else None
        jitted: Any = eqx.filter_jit
        return jitted(function, compiler_options=options)

    @functools.wraps(function)
    def call(*arguments: _P.args, **options: _P.kwargs) -> _R:
        return compiled()(*arguments, **options)

    return call
