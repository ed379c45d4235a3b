"""Writing files atomically: under a temporary name, then renamed."""

import contextlib
import errno
import os
import stat
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.bounded import reported
from jaxscan.files.disk.opening import shown
from jaxscan.files.disk.partial import Part, partial_file
from jaxscan.files.disk.writing import sync_to_disk


def write_atomically(
    path: str | Path,
    content: bytes | Callable[[Part], None],
    *,
    durable: bool = True,
    error: type[JaxscanError] = JaxscanError,
    links: Literal["follow", "replace"] = "follow",
) -> None:
    """Write a file so that `path` holds either the old content or all of the new.

    Args:
        path: The file; its folder must exist.
        content: The bytes, or a function that writes the file at a given path; that path has the same
            suffix and lies in the same folder.
        durable: Wait until the content is on the disk, so that it survives a loss of power.
        error: Type of the error raised.
        links: Where `path` is a link: "follow" writes the file that it leads to; "replace" puts the file in
            place of the link, as in the folder of a capture, whose links may lead anywhere.

    Raises:
        JaxscanError: Of type `error`, if the file cannot be written. Then nothing has changed.
    """
    _write({path: content}, durable=durable, error=error, links=links)


def write_together(
    contents: Mapping[Path, bytes | Callable[[Part], None]], *, error: type[JaxscanError] = JaxscanError
) -> None:
    """Write files that belong together: all are complete and on the disk before the first gets its name.

    Args:
        contents: The bytes of each file, or the function that writes it, as for `write_atomically`. They are called in
            their order, and the files get their names in it, with nothing between.
        error: Type of the error raised.

    Raises:
        JaxscanError: Of type `error`, if a file cannot be written. Then nothing has changed, unless the disk refused
            only the name of a later one.
    """
    _write(contents, durable=True, error=error, links="follow")


def _write(
    contents: Mapping[Any, bytes | Callable[[Part], None]],
    *,
    durable: bool,
    error: type[JaxscanError],
    links: Literal["follow", "replace"],
) -> None:
    parts: list[tuple[str | Path, Path, Part]] = []
    with contextlib.ExitStack() as stack:
        for path, content in contents.items():
            with _reported(path, error):
                target = _target(path, links)
                part = stack.enter_context(partial_file(target))
                if callable(content):
                    content(part)
                else:
                    part.write_bytes(content)
                if durable:
                    sync_to_disk(part)
                parts.append((path, target, part))
        for path, target, part in parts:
            with _reported(path, error):
                os.replace(part, target)
        if durable and os.name == "posix":
            for path, target, _ in parts:
                with _reported(path, error):
                    sync_to_disk(target.parent)


def check_writable(path: str | Path, *, error: type[JaxscanError] = JaxscanError) -> None:
    """Check that a file can be written, before its content is computed.

    Args:
        path: The file.
        error: Type of the error raised.

    Raises:
        JaxscanError: Of type `error`, if `write_atomically` would refuse.
    """
    with _reported(path, error):
        target = _target(path, "follow")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _reported(path: str | Path, error: type[JaxscanError]) -> contextlib.AbstractContextManager[None]:
    return reported(f"{shown(path)}: cannot be written", error=error)


def _target(path: str | Path, links: Literal["follow", "replace"]) -> Path:
    """The path that is renamed to, checked."""
    try:
        target = Path(os.path.realpath(path) if links == "follow" else os.path.abspath(path))
        # Other libraries raise errors of their own for a missing folder.
        if not os.path.isdir(target.parent):
            raise OSError(f"the folder {target.parent} does not exist; create it first")
        mode = os.lstat(target).st_mode
    except FileNotFoundError:
        return target
    except ValueError as problem:
        raise OSError(f"no file can have this name: {problem}") from problem
    # Renaming would replace a device or a folder, although the user only meant to write into it.
    if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode)):
        raise OSError("it exists and is not a regular file")
    return target
