"""The one door through which files and folders are made, and files are opened for writing.

A path that the user names on the command line may be a link. In an untrusted folder, such as that of a capture or a
project, a link may lead anywhere: there nothing is written through one.
"""

import contextlib
import errno
import io
import os
import stat
from pathlib import Path
from typing import Literal

from jaxscan.files.disk.reading import NO_LINK


Opened = Literal["make", "change", "append"]
_FLAGS = NO_LINK | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
_HOW: dict[Opened, tuple[int, str]] = {
    "make": (os.O_RDWR | os.O_CREAT | os.O_EXCL, "r+b"),
    "change": (os.O_RDWR, "r+b"),
    "append": (os.O_RDWR | os.O_CREAT | os.O_APPEND, "ab"),
}
_LINK = "found a link, which may lead anywhere, expected the file or folder itself"


def open_to_write(path: str | Path, how: Opened, *, mode: int = 0o666) -> io.FileIO:
    """Open a regular file for writing, without buffering; nothing of one that exists is cut off.

    Args:
        path: The file; it may not be a link, whether that leads anywhere or not.
        how: "make" a new one, "change" one that exists in place, or "append" to one, which is made where it is missing.
        mode: Permissions of one that is made.

    Raises:
        OSError: If it cannot be opened, or is a link, a folder, a device or a pipe.
    """
    flags, text = _HOW[how]
    try:
        handle = os.open(path, flags | _FLAGS, mode)
    except OSError as problem:
        if problem.errno in (errno.ELOOP, errno.EEXIST) and os.path.islink(path):
            raise OSError(errno.ELOOP, _LINK, str(path)) from problem
        raise
    try:
        # Checked after opening, so that it cannot be exchanged in between.
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "found a device or pipe, expected a file", str(path))
        return io.FileIO(handle, text)
    except BaseException:
        os.close(handle)
        raise


def open_to_append(path: str | Path) -> io.FileIO:
    """Open a file to append to it, as `open_to_write` does."""
    return open_to_write(path, "append")


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


def make_folder(path: str | Path, *, durable: bool = False, new: bool = False, own: Path | None = None) -> None:
    """Make a folder and its missing parents; one that exists is kept.

    Args:
        durable: Wait for the disk, so that they survive a loss of power.
        new: Refuse one that exists.
        own: An untrusted folder in which `path` lies: no link is followed from there on.

    Raises:
        OSError: If it cannot be made.
    """
    path = Path(path)
    if own is not None:
        refuse_links(own, path)
    missing = [above for above in (path, *path.parents) if not os.path.exists(above)]
    try:
        os.makedirs(path, exist_ok=not new)
    except FileExistsError as problem:
        if os.path.isdir(path):
            raise
        found = _LINK if os.path.islink(path) else os.strerror(errno.ENOTDIR)
        raise NotADirectoryError(errno.ENOTDIR, found, str(path)) from problem
    if durable and os.name == "posix":
        for folder in [path, *missing[1:]]:
            # A folder that may be written but not listed cannot be waited for.
            with contextlib.suppress(PermissionError):
                sync_to_disk(folder.parent)


def refuse_links(own: Path, path: str | Path) -> None:
    """Check that a path lies in a folder, and that nothing on the way from there, itself too, is a link.

    Args:
        own: An untrusted folder, such as that of a project's products.
        path: A path in it, which need not exist.

    Raises:
        OSError: If a link is on the way, or the path leads out of the folder.
    """
    parts = Path(path).relative_to(own).parts if Path(path).is_relative_to(own) else ("..",)
    if ".." in parts:
        raise OSError(errno.EINVAL, f"lies outside of {own}", str(path))
    place = Path(own)
    for part in parts:
        place /= part
        if os.path.islink(place):
            raise OSError(errno.ELOOP, _LINK if place == Path(path) else f"{place.name}: {_LINK}", str(path))


def is_outside(path: str | Path, folder: str | Path) -> bool:
    """Whether a path lies outside of a folder, all links followed, also those that lead nowhere yet."""
    return not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def sync_to_disk(path: Path) -> None:
    """Wait until a file, or the list of names in a folder, is safe from a loss of power."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
