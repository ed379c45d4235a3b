"""The one door through which files and folders are made, and files are opened for writing.

A path that the user names on the command line may be a link. In an untrusted folder, such as that of a capture or a
project, a link may lead anywhere: there nothing is written through one.
"""

import contextlib
import errno
import io
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NewType

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.reading import NO_LINK, reported, shown


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


# Writing whole or not at all: a file or folder appears under its name when it is complete.


# Partial files and folders have a temporary name, are locked, and are removed unless they are renamed.
#
# A process that is killed leaves them behind, stale. Their lock is then free, so the next process that makes one in the
# same folder removes them.

try:
    import fcntl
except ImportError:  # Not on Windows; there nothing is locked, and nothing of others is removed.
    fcntl = None  # type: ignore[assignment]


# Strict, because files with such a name and without a lock are removed.
_NAME = re.compile(r"\.part-[0-9a-f]{12}(\.[A-Za-z0-9_]{1,16})?")
_DIGITS = 6
_TRIES = 50

Part = NewType("Part", Path)
"""A partial file or folder, made here under a name of its own: it may be opened for writing by any library."""

_held: dict[Path, tuple[int, int | None]] = {}
"""The process that made each partial file or folder, since a forked child made none, and the handle of its lock."""
_cleared: set[Path] = set()
"""Folders from which this process has removed stale ones. It does so once: a capture writes thousands of files."""


@contextlib.contextmanager
def partial_file(target: str | Path) -> Iterator[Part]:
    """A new empty file beside `target`, with its suffix; rename it when it is complete.

    Yields:
        Its path, `.part-<hex><suffix>`. It is locked, and removed at the end unless it was renamed.

    Raises:
        OSError: If it cannot be made.
    """
    target = Path(target)
    if target.parent not in _cleared:
        remove_stale(target.parent)
        _cleared.add(target.parent)
    suffix = target.suffix if _NAME.fullmatch(f".part-{'0' * 2 * _DIGITS}{target.suffix}") else ""
    with _made(target.parent, suffix, _make_file) as part:
        yield part


@contextlib.contextmanager
def partial_folder(target: str | Path) -> Iterator[Part]:
    """A new empty folder beside `target`; rename it when it is complete.

    Yields:
        Its path, `.part-<hex>`. It is locked, and removed with all that it holds unless it was renamed.

    Raises:
        OSError: If it cannot be made.
    """
    target = Path(target)
    remove_stale(target.parent)
    with _made(target.parent, "", _make_folder) as part:
        yield part


def forget_partials() -> None:
    """Remove all partial files and folders of this process, before it ends by a signal."""
    for part in list(_held):
        _remove(part)


def remove_stale(folder: str | Path) -> None:
    """Remove the partial files and folders in `folder` whose processes have ended."""
    if fcntl is None:
        return
    # Those that cannot be listed, locked or removed stay; they do no harm.
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in [entry for entry in entries if _NAME.fullmatch(entry.name)]:
            with contextlib.suppress(OSError):
                _remove_if_stale(Path(entry.path))


@contextlib.contextmanager
def _made(folder: Path, suffix: str, make: Callable[[Path], int | None]) -> Iterator[Part]:
    part = _lock_new(folder, suffix, make)
    try:
        yield part
    finally:
        _remove(part)


def _lock_new(folder: Path, suffix: str, make: Callable[[Path], int | None]) -> Part:
    tries = 0
    while True:
        part = folder / f".part-{secrets.token_hex(_DIGITS)}{suffix}"
        # Registered before it is made: a signal may come as soon as it exists.
        _held[part] = os.getpid(), None
        try:
            handle = make(part)
        except BaseException as problem:
            del _held[part]
            tries += 1
            # Another process may have removed it as stale before it was opened.
            if isinstance(problem, FileNotFoundError) and os.path.isdir(folder) and tries < _TRIES:
                continue
            raise
        _held[part] = os.getpid(), handle
        # Another process may have taken it for stale before it was locked.
        if handle is None or (_lock(handle) and _is_at(part, handle)):
            return Part(part)
        _remove(part)


def _make_file(part: Path) -> int | None:
    if fcntl is None:
        part.touch(exist_ok=False)
        return None
    return os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)


def _make_folder(part: Path) -> int | None:
    os.mkdir(part)
    if fcntl is None:
        return None
    try:
        return os.open(part, os.O_RDONLY | os.O_CLOEXEC)
    except BaseException:
        with contextlib.suppress(OSError):
            os.rmdir(part)
        raise


def _lock(handle: int) -> bool:
    """Whether nobody else holds the lock; where a disk knows no locks, nobody can take one."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def _is_at(part: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.lstat(part), os.fstat(handle))
    except FileNotFoundError:
        return False


def _remove(part: Path) -> None:
    """Remove a file or folder that this process holds, if it still has its partial name, and let go of it."""
    process, handle = _held.pop(part, (-1, None))
    if process != os.getpid():
        return
    try:
        # If it cannot be removed, it stays; the failure that led here is the one to report.
        with contextlib.suppress(OSError):
            if handle is None or _is_at(part, handle):
                _delete(part)
    finally:
        if handle is not None:
            os.close(handle)


def _remove_if_stale(part: Path) -> None:
    regular = stat.S_ISREG(os.lstat(part).st_mode)
    # Network disks lock only files that are open for writing.
    flags = os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC | (os.O_RDWR if regular else os.O_RDONLY | os.O_DIRECTORY)
    handle = os.open(part, flags)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _is_at(part, handle):
            _delete(part)
    finally:
        os.close(handle)


def _delete(part: Path) -> None:
    if not os.path.isdir(part):
        part.unlink()
        return
    # Threads of a process that ends by a signal may write on for a moment.
    for _ in range(_TRIES):
        shutil.rmtree(part, ignore_errors=True)
        if not os.path.exists(part):
            return
        time.sleep(0.01)


@contextlib.contextmanager
def whole_folder(target: str | Path, *, durable: bool = True) -> Iterator[Part]:
    """A partial folder, whose files get their names in `target` when all of them are complete.

    Args:
        target: Where it is to be. Missing folders above it are made at the end. In one that exists, files of the same
            names are replaced and others stay.
        durable: Wait at the end until all is on the disk.

    Yields:
        Its path. After an error, it and all that it holds is removed, and nothing has changed.

    Raises:
        OSError: If it cannot be made, or something that is no folder has the name.
    """
    target = Path(os.path.abspath(target))
    above = target
    while not os.path.isdir(above):
        above = above.parent
    # Inside the folder where it exists already, since it may be on another disk.
    with partial_folder(above / "folder") as part:
        yield part
        files = sorted(Path(place, name) for place, _, names in os.walk(part) for name in names)
        folders = sorted(Path(place) for place, _, _ in os.walk(part))
        if durable:
            for one in (*files, *reversed(folders)):
                sync_to_disk(one)
        if above != target:
            make_folder(target.parent)
            os.rename(part, target)
            sync_to_disk(target.parent)
            return
        for folder in folders:
            make_folder(target / folder.relative_to(part))
        for file in files:
            os.replace(file, target / file.relative_to(part))


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
        links: "replace" puts the file in place of a link, as in the folder of a capture, whose links may lead anywhere.

    Raises:
        JaxscanError: Of type `error`, if the file cannot be written. Then nothing has changed.
    """
    write_together({path: content}, durable=durable, error=error, links=links)


def write_together(
    contents: Mapping[Any, bytes | Callable[[Part], None]],
    *,
    durable: bool = True,
    error: type[JaxscanError] = JaxscanError,
    links: Literal["follow", "replace"] = "follow",
) -> None:
    """Write files that belong together: all are complete and on the disk before the first gets its name.

    Args:
        contents: The bytes of each file, or the function that writes it, as for `write_atomically`. They are called in
            their order, and the files get their names in it, with nothing between.
        durable, links: As for `write_atomically`.

    Raises:
        JaxscanError: Of type `error`, if a file cannot be written. Then nothing has changed, unless the disk refused
            only the name of a later one.
    """
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
