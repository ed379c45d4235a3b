"""How functions are compiled on a CPU: sooner where they run a few times, for wide vectors where they run often."""

import functools
import re
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar

import jax


_P, _R = ParamSpec("_P"), TypeVar("_R")


def compile_quickly(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Like `jax.jit`, but on a CPU compiling takes a quarter of the time, and the code takes three times as long.

    For functions that run a few times in a process, and are called by the host: not inside of another compiled
    function, where JAX takes no such options. Accelerators compile as ever.
    """
    return compile_with(function, {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False})


def compile_sooner(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Like `compile_quickly`, but compiling takes two thirds of the time, and the code up to twice as long.

    For functions that run some ten times.
    """
    return compile_with(function, {"xla_cpu_use_fusion_emitters": False})


def compile_wide(function: Callable[_P, _R], *, static: Sequence[str] = (), sooner: bool = False) -> Callable[_P, _R]:
    """Like `jax.jit`, but with vectors as wide as the CPU has them: XLA takes half of AVX-512 by itself.

    Args:
        function: It runs often, on long arrays.
        static: Names of its static arguments.
        sooner: Whether it is compiled in two thirds of the time, to code that takes a twentieth longer.
    """
    options = {"xla_cpu_prefer_vector_width": 512, **({"xla_cpu_use_fusion_emitters": False} if sooner else {})}
    return compile_with(function, options, static)


_UNKNOWN: set[str] = set()
"""Options that the installed XLA does not have: its releases drop some, and it refuses what it does not know."""


def compile_with(function: Callable[_P, _R], options: dict[str, Any], static: Sequence[str] = ()) -> Callable[_P, _R]:
    """Like `jax.jit`, but on a CPU with these options of XLA, as far as the installed release has them."""

    @functools.cache
    def compiled(unknown: frozenset[str]) -> Callable[_P, _R]:
        # Asked at the first call: asking chooses the device, which is not for an import to do.
        on_cpu = jax.default_backend() == "cpu"
        known = {name: value for name, value in options.items() if on_cpu and name not in unknown}
        return jax.jit(function, static_argnames=tuple(static), compiler_options=known or None)

    @functools.wraps(function)
    def call(*arguments: _P.args, **keywords: _P.kwargs) -> _R:
        while True:
            unknown = frozenset(_UNKNOWN)
            try:
                return compiled(unknown)(*arguments, **keywords)
            except jax.errors.JaxRuntimeError as problem:
                refused = re.search("No such compile option: '(\\w+)'", str(problem))
                if refused is None or refused[1] in unknown:
                    raise
                _UNKNOWN.add(refused[1])

    return call
