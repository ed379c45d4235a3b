"""Reading files of any origin: only regular files, and at most a given number of bytes."""

import contextlib
import hashlib
import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxscan.errors import JaxscanError


MEGABYTE = 1 << 20


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


def read_bounded(path: str | Path, limit: int, *, error: type[JaxscanError]) -> bytes:
    """All bytes of a regular file of at most `limit` bytes.

    Args:
        path: The file.
        limit: Largest accepted size [bytes].
        error: Type of the error raised.

    Raises:
        JaxscanError: Of type `error`, if it is missing, not a regular file, unreadable or larger.
    """
    try:
        # Opening a pipe would wait for ever, so look first.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise error(f"{path}: found {'a folder' if os.path.isdir(path) else 'a device or pipe'}, expected a file.")
        with open(path, "rb") as file:
            # As large as it is now: a journal may grow, and Python allocates all that is asked for.
            size = os.fstat(file.fileno()).st_size
            if size > limit:
                raise error(f"{path}: larger than the {limit / MEGABYTE:g} MiB that such a file may have.")
            return file.read(size)
    except FileNotFoundError as problem:
        raise error(f"{path}: no such file.") from problem
    except (OSError, ValueError) as problem:
        raise error(f"{path}: cannot be read: {getattr(problem, 'strerror', None) or problem}.") from problem


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
        return json.loads(data.decode("utf-8"), parse_constant=refuse)
    except json.JSONDecodeError as problem:
        raise error(f"{name}: line {problem.lineno}: not valid JSON: {problem.msg}.") from problem
    except UnicodeDecodeError as problem:
        raise error(f"{name}: not UTF-8 text (byte {problem.start}).") from problem
    except (ValueError, RecursionError) as problem:
        raise error(f"{name}: not valid JSON: {problem}.") from problem


def file_digest(path: str | Path, *, error: type[JaxscanError] = JaxscanError) -> str:
    """The sha256 of a file, as "sha256:<hex>".

    Raises:
        JaxscanError: Of type `error`, if it cannot be read.
    """
    with reported(f"{path}: cannot be read", error=error), open(path, "rb") as file:
        return "sha256:" + hashlib.file_digest(file, "sha256").hexdigest()
