"""Room on the disk: asked for before a capture, watched while it grows."""

import errno
import shutil
from pathlib import Path

from scanrig.errors import SessionError


_FULL = {errno.ENOSPC, errno.EDQUOT} if hasattr(errno, "EDQUOT") else {errno.ENOSPC}
KEPT_PAIRS = 2
"""Pairs for which there has to be room before one is taken."""


class DiskFull(SessionError):
    """No room for the next pair; the capture is whole and can be resumed."""


def require_space(folder: Path, needed: int, *, what: str) -> None:
    """See that there is room.

    Args:
        folder: Where.
        needed: How much [bytes].
        what: What it is for.

    Raises:
        DiskFull: If there is less.
    """
    free = free_bytes(folder)
    if free < needed:
        raise DiskFull(
            f"{folder}: {readable(free)} are free, {what} needs {readable(needed)}; "
            "make room, then go on with --resume."
        )


def free_bytes(folder: Path) -> int:
    """What this user may still write [bytes]."""
    return shutil.disk_usage(folder).free


def is_full(problem: BaseException) -> bool:
    """Whether an error, or what caused it, is that no room is left."""
    cause: BaseException | None = problem
    while cause is not None:
        if isinstance(cause, DiskFull):
            return True
        if isinstance(cause, OSError) and cause.errno in _FULL:
            return True
        cause = cause.__cause__
    return False


def readable(size: int) -> str:
    """A number of bytes for people."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
