"""Texts and digests of files of any origin, and failures of the system in one line."""

import contextlib
import hashlib
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.opening import open_regular


MAX_DEPTH = 64
"""Most tables and lists within one another; a function that walks through a value may recurse."""


@contextlib.contextmanager
def reported(failure: object, *, error: type[JaxscanError]) -> Iterator[None]:
    """Report an `OSError` in one line: `failure`, such as "<file>: cannot be written", and the reason.

    Raises:
        JaxscanError: Of type `error`.
    """
    try:
        yield
    except OSError as problem:
        raise error(f"{failure}: {problem.strerror or problem}.") from problem


def parse_json(data: bytes, *, name: str, error: type[JaxscanError]) -> Any:
    """The value of a JSON text; `NaN` and `Infinity`, which are not JSON, are refused.

    Args:
        data: The text, UTF-8.
        name: Name of the file, for messages.
        error: Type of the error raised.

    Raises:
        JaxscanError: Of type `error`, with the line where there is one.
    """

    def refuse(constant: str) -> Any:
        raise ValueError(f"{constant} is not a number that JSON knows")

    try:
        value = json.loads(data.decode("utf-8"), parse_constant=refuse)
    except json.JSONDecodeError as problem:
        raise error(f"{name}: line {problem.lineno}: not valid JSON: {problem.msg}.") from problem
    except UnicodeDecodeError as problem:
        raise error(f"{name}: not UTF-8 text (byte {problem.start}).") from problem
    except RecursionError as problem:
        raise error(too_deep(name)) from problem
    except ValueError as problem:
        raise error(f"{name}: not valid JSON: {problem}.") from problem
    if is_deep(value):
        raise error(too_deep(name))
    return value


def is_deep(value: Any) -> bool:
    """Whether a value of JSON or TOML has more than `MAX_DEPTH` tables and lists within one another."""
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        inner = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)]
        if not inner:
            return False
        level = list(itertools.chain.from_iterable(inner))
    return True


def too_deep(name: str) -> str:
    """The message about such a value."""
    return f"{name}: nested too deeply, expected at most {MAX_DEPTH} tables or lists within one another."


def file_digest(path: str | Path, *, limit: int | None = None, error: type[JaxscanError] = JaxscanError) -> str:
    """The sha256 of a file, as "sha256:<hex>".

    Args:
        path: The file.
        limit: Largest accepted size [bytes].
        error: Type of the error raised.

    Raises:
        JaxscanError: Of type `error`, if it cannot be read, or is larger.
    """
    with reported(f"{path}: cannot be read", error=error), open_regular(path, error=error, limit=limit) as file:
        return "sha256:" + hashlib.file_digest(file, "sha256").hexdigest()
