"""Reading untrusted files: only regular files, of bounded size, with names that can be shown."""

import contextlib
import errno
import hashlib
import io
import itertools
import json
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from jaxscan.errors import JaxscanError


Links = Literal["follow", "refuse"]
MEGABYTE = 1 << 20

# Opening a pipe would wait for a writer for ever. Not every system has each of these flags.
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def open_regular(
    path: str | Path, *, error: type[JaxscanError], limit: int | None = None, links: Links = "follow"
) -> io.BufferedReader:
    """Open a regular file for reading; the caller closes it.

    Args:
        limit: Largest accepted size [bytes].
        links: "refuse" where the file itself must not be a link, such as in the folder of a capture, whose links
            may lead anywhere. Folders above it may be links.

    Returns:
        The file, at its beginning.

    Raises:
        JaxscanError: Of type `error`, in one line, if it is missing, a folder, a device or a pipe, a refused link,
            unreadable, or larger than `limit`.
    """
    try:
        if links == "refuse" and os.path.islink(path):
            raise OSError(errno.ELOOP, "")
        handle = os.open(path, _FLAGS | (NO_LINK if links == "refuse" else 0))
    except FileNotFoundError as problem:
        raise error(f"{path}: no such file.") from problem
    except (OSError, ValueError) as problem:
        if links == "refuse" and getattr(problem, "errno", None) == errno.ELOOP:
            raise error(f"{path}: found a link, expected the file itself; copy it there.") from problem
        raise error(f"{shown(path)}: cannot be read: {getattr(problem, 'strerror', None) or problem}.") from problem
    try:
        # Checked after opening, so that the file cannot be exchanged in between.
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            found = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or pipe"
            raise error(f"{path}: found {found}, expected a file.")
        if limit is not None and status.st_size > limit:
            raise error(f"{path}: larger than the {limit / MEGABYTE:g} MiB that such a file may have.")
        # Libraries open the file by this name, and messages contain it.
        return open(path, "rb", opener=lambda *_: handle)
    except BaseException:
        os.close(handle)
        raise


def read_bounded(path: str | Path, limit: int, *, error: type[JaxscanError], links: Links = "follow") -> bytes:
    """All bytes of a regular file of at most `limit` bytes.

    Args:
        limit: Largest accepted size [bytes].
        links: As in `open_regular`.

    Raises:
        JaxscanError: Of type `error`, for the reasons of `open_regular`.
    """
    with open_regular(path, error=error, limit=limit, links=links) as file:
        try:
            # Read only its present size: a journal may grow, and Python allocates the full limit at once.
            return file.read(os.fstat(file.fileno()).st_size)
        except OSError as problem:
            raise error(f"{path}: cannot be read: {problem.strerror or problem}.") from problem


def check_name(path: str | Path, *, error: type[JaxscanError]) -> None:
    """Check that a file or folder can have this name, before its content is computed.

    Raises:
        JaxscanError: Of type `error`, if the name is too long, holds letters that no name has, or lies in a file.
    """
    try:
        os.lstat(path)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as problem:
        raise error(f"{shown(path)}: cannot be written: {getattr(problem, 'strerror', None) or problem}.") from problem


def shown(path: str | Path) -> str:
    """A path for a message: names that are too long for any file system are cut."""
    text = str(path)
    return text if len(text) <= 1024 else f"{text[:512]}...{text[-256:]}"


_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
COPY_FIRST = "copy it to a disk first, such as with aws s3 sync or rclone"


def is_address(path: str | Path) -> bool:
    """Whether a text is an address, such as s3://bucket/room, and no path; a drive has only one letter."""
    return _ADDRESS.match(str(path)) is not None


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
        limit: Largest accepted size [bytes].

    Raises:
        JaxscanError: Of type `error`, if it cannot be read, or is larger.
    """
    with reported(f"{path}: cannot be read", error=error), open_regular(path, error=error, limit=limit) as file:
        return "sha256:" + hashlib.file_digest(file, "sha256").hexdigest()
