"""Files and folders in work: under a temporary name, locked, and removed unless they get their final name.

A process that is killed leaves them behind. Their lock then is free, so the next process that makes one in the same
folder removes them. On a network disk other computers may not see the lock, so there they must be old too.
"""

import contextlib
import itertools
import os
import re
import secrets
import shutil
import stat
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NewType

from jaxscan.files.disk.network import is_on_network


try:
    import fcntl
except ImportError:  # Not on Windows; there nothing is locked, and nothing of others is removed.
    fcntl = None  # type: ignore[assignment]


# Strict, because files with such a name and without a lock are removed.
_NAME = re.compile(r"\.part-[0-9a-f]{12}(\.[A-Za-z0-9_]{1,16})?")
_DIGITS = 6
_TRIES = 50
_QUIET_S = 3600.0
"""On a network disk, one that has not changed for so long is a left one."""
_LOOKED_AT = 4096
"""Most entries of a folder that are asked for their age; folders come before the files in them."""

Part = NewType("Part", Path)
"""A file or folder in work: made here, under a name of its own. Writers that take one need no door of their own."""

_held: dict[Path, tuple[int, int | None]] = {}
"""The process that made each partial file or folder, for a forked one has made none, and the handle with its lock."""
_cleared: set[Path] = set()
"""Folders from which this process has removed the left ones: once, for a capture writes thousands of files."""


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
        remove_left(target.parent)
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
    remove_left(target.parent)
    with _made(target.parent, "", _make_folder) as part:
        yield part


def forget_partials() -> None:
    """Remove all partial files and folders of this process, before it ends by a signal."""
    for part in list(_held):
        _remove(part)


def remove_left(folder: str | Path) -> None:
    """Remove the partial files and folders in `folder` whose processes have ended."""
    if fcntl is None:
        return
    # Those that cannot be listed, locked or removed stay; they hinder nobody.
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        names = [entry.name for entry in entries if _NAME.fullmatch(entry.name)]
        quiet_s = _QUIET_S if names and is_on_network(folder) else None
        for part in (Path(folder, name) for name in names):
            with contextlib.suppress(OSError):
                _remove_if_left(part, quiet_s)


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
        # Noted first: a signal may come as soon as it exists.
        _held[part] = os.getpid(), None
        try:
            handle = make(part)
        except BaseException as problem:
            del _held[part]
            tries += 1
            # Another process may have removed it, as a left one, before it was opened.
            if isinstance(problem, FileNotFoundError) and os.path.isdir(folder) and tries < _TRIES:
                continue
            raise
        _held[part] = os.getpid(), handle
        # Another process may have taken it for a left one before it was locked.
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


def _remove_if_left(part: Path, quiet_s: float | None) -> None:
    regular = stat.S_ISREG(os.lstat(part).st_mode)
    # Network disks lock only files that are open for writing.
    flags = os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC | (os.O_RDWR if regular else os.O_RDONLY | os.O_DIRECTORY)
    handle = os.open(part, flags)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _is_at(part, handle) and (quiet_s is None or time.time() - _changed_at(part) > quiet_s):
            _delete(part)
    finally:
        os.close(handle)


def _changed_at(part: Path) -> float:
    """When a file, or the newest of a folder's entries, was last changed [s since 1970]."""
    newest, waiting, left = os.lstat(part).st_mtime, deque([part] if os.path.isdir(part) else []), _LOOKED_AT
    while waiting and left > 0:
        folder = waiting.popleft()
        with os.scandir(folder) as entries:
            for entry in itertools.islice(entries, left):
                left -= 1
                status = entry.stat(follow_symlinks=False)
                newest = max(newest, status.st_mtime)
                if stat.S_ISDIR(status.st_mode):
                    waiting.append(Path(entry.path))
    return newest


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
