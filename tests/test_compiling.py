"""How functions are compiled."""

import jax.numpy as jnp
import pytest

from jaxscan.compiling import compile_with


def test_options_that_this_xla_does_not_have_are_left_out() -> None:
    """A release of XLA that dropped an option compiles with the others."""
    options = {"xla_cpu_an_option_of_another_release": True, "xla_backend_optimization_level": 0}
    double = compile_with(lambda number: 2 * number, options)
    assert double(jnp.float32(3)) == 6


def test_another_error_of_the_compiler_is_raised() -> None:
    """Only an option's name that XLA does not know is forgiven, not its value."""
    double = compile_with(lambda number: 2 * number, {"xla_backend_optimization_level": "much"})
    with pytest.raises(Exception, match="xla_backend_optimization_level"):
        double(jnp.float32(3))
