"""The one door through which files are opened for reading: regular files only, and none that is too large."""

import errno
import io
import os
import stat
from pathlib import Path
from typing import Literal

from jaxscan.errors import JaxscanError


Links = Literal["follow", "refuse"]
MEGABYTE = 1 << 20

# Opening a pipe would wait for a writer for ever. Not every system has each of these flags.
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of `os.open` that refuses a link."""


def open_regular(
    path: str | Path, *, error: type[JaxscanError], limit: int | None = None, links: Links = "follow"
) -> io.BufferedReader:
    """Open a regular file for reading; the caller closes it.

    Args:
        path: The file.
        error: Type of the error raised.
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
        # Looked at after opening, so that nobody can exchange the file in between.
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            found = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or pipe"
            raise error(f"{path}: found {found}, expected a file.")
        if limit is not None and status.st_size > limit:
            raise error(f"{path}: larger than the {limit / MEGABYTE:g} MiB that such a file may have.")
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_bounded(path: str | Path, limit: int, *, error: type[JaxscanError], links: Links = "follow") -> bytes:
    """All bytes of a regular file of at most `limit` bytes.

    Args:
        path: The file.
        limit: Largest accepted size [bytes].
        error: Type of the error raised.
        links: As in `open_regular`.

    Raises:
        JaxscanError: Of type `error`, for the reasons of `open_regular`.
    """
    with open_regular(path, error=error, limit=limit, links=links) as file:
        try:
            # As large as it is now: a journal may grow, and Python allocates all that is asked for.
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
