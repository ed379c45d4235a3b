"""Writing files atomically: under a temporary name, then renamed."""

import contextlib
import errno
import io
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.bounded import reported


def write_atomically(
    path: str | Path,
    content: bytes | Callable[[Path], None],
    *,
    durable: bool = True,
    error: type[JaxscanError] = JaxscanError,
) -> None:
    """Write a file so that `path` holds either the old content or all of the new.

    Args:
        path: The file; its folder must exist. A link is followed.
        content: The bytes, or a function that writes the file at a given path; that path has the same
            suffix and lies in the same folder.
        durable: Wait until the content is on the disk, so that it survives a loss of power.
        error: Type of the error raised.

    Raises:
        JaxscanError: Of type `error`, if the file cannot be written. Then nothing has changed.
    """
    target = Path(os.path.realpath(path))
    part = target.with_name(f".part-{secrets.token_hex(6)}{target.suffix}")
    try:
        with reported(f"{path}: cannot be written", error=error):
            _check_target(target)
            if callable(content):
                content(part)
            else:
                part.write_bytes(content)
            if durable:
                sync_to_disk(part)
            os.replace(part, target)
            if durable and os.name == "posix":
                sync_to_disk(target.parent)
    finally:
        part.unlink(missing_ok=True)


def check_writable(path: str | Path, *, error: type[JaxscanError] = JaxscanError) -> None:
    """Check that a file can be written, before its content is computed.

    Args:
        path: The file.
        error: Type of the error raised.

    Raises:
        JaxscanError: Of type `error`, if `write_atomically` would refuse.
    """
    target = Path(os.path.realpath(path))
    with reported(f"{path}: cannot be written", error=error):
        _check_target(target)
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def append_whole(file: io.FileIO, data: bytes, *, durable: bool) -> None:
    """Append all of `data` to a file, or nothing; a part that was written is removed where the disk allows it.

    Raises:
        OSError: If it cannot be written.
    """
    before = os.fstat(file.fileno()).st_size
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[file.write(rest) or 0 :]
        if durable:
            os.fsync(file.fileno())
    except BaseException:
        with contextlib.suppress(OSError):
            os.ftruncate(file.fileno(), before)
        raise


def _check_target(target: Path) -> None:
    # Other libraries raise errors of their own for a missing folder.
    if not target.parent.is_dir():
        raise OSError(f"the folder {target.parent} does not exist; create it first")
    # Renaming would replace a device or a folder, although the user only meant to write into it.
    if target.exists() and not stat.S_ISREG(target.stat().st_mode):
        raise OSError("it exists and is not a regular file")


def sync_to_disk(path: Path) -> None:
    """Wait until a file, or the list of names in a folder, is safe from a loss of power."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
