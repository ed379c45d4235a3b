"""Values that break programs: numbers at the ends of their types, texts that steer terminals, shapes that recurse."""

import random
from collections.abc import Callable
from typing import Any


TEXTS = (
    "",
    "x",
    "NaN",
    "-inf",
    "../../victim",
    "/etc/passwd",
    "a" * 300,
    "b" * 100_000,
    "\x00",
    "\x1b]52;c;cm0gLXJmIH4=\x07",
    "\x1b[2J\x1b[31mred",
    "\x9b31mred\x9d0;title\x9c",
    "\u202eleft\u2066\u200b",
    "line\u2028separator\x85next",
    "two\nlines\r\nor three",
    "<script>alert(1)</script>",
    "%s%n{0.__class__}[/red]",
    "\ud800",
)
NUMBERS = (
    *(0, 1, -1, 2, 3, 7, 255, 256, 65535, 65536, 10**6, 2**31 - 1, 2**31, 2**32, 2**53, 2**63, -(2**63), 10**30),
    *(-0.0, 0.5, -0.5, 1e-300, 5e-324, 1e-9, 1e9, 1e30, 1e154, 1e308, -1e308, float("inf"), float("nan")),
)


def pick(rng: random.Random, *changes: Callable[[], Any]) -> Any:
    """One of several changes, each as likely as the others."""
    return rng.choice(changes)()


def nasty_text(rng: random.Random) -> str:
    """A text that no file of ours holds."""
    return rng.choice(TEXTS)


def nasty_number(rng: random.Random) -> int | float:
    """A number at the end of some type or range."""
    return rng.choice(NUMBERS)


def nasty_value(rng: random.Random) -> Any:
    """A JSON value of any kind."""
    kind = rng.randrange(8)
    if kind < 3:
        return nasty_number(rng)
    if kind < 5:
        return nasty_text(rng)
    return rng.choice((None, True, False, [], {}, [[]], nested(20), nested(900), [0.0] * 5000, {"a": {"b": [1]}}))


def nested(depth: int) -> list:
    """A list in a list in a list."""
    value: list = []
    for _ in range(depth):
        value = [value]
    return value


def near(rng: random.Random, value: int | float) -> int | float:
    """A number near another one: a wrong digit, sign, unit or power of ten."""
    if isinstance(value, int):
        return rng.choice((value + 1, value - 1, -value, 2 * value, 10 * value, value // 2))
    return rng.choice(
        (
            *(-value, 10 * value, value / 10, 1000 * value, value / 1000, value + 1.0, value * 57.29577951308232),
            *(value * (1 + 10 ** rng.uniform(-6, 0)), value + rng.gauss(0, 1)),
        )
    )
