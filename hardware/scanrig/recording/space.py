"""Free space on the disk, checked before a capture and before every pair."""

import errno
import shutil
from pathlib import Path

from scanrig.errors import SessionError


_FULL = {errno.ENOSPC, errno.EDQUOT} if hasattr(errno, "EDQUOT") else {errno.ENOSPC}
KEPT_PAIRS = 2
"""There must be space for this many pairs before one is taken."""


class DiskFull(SessionError):
    """No space for the next pair; the capture is whole and can be resumed."""


def require_space(folder: Path, needed: int, *, purpose: str) -> None:
    """Check that there is enough space.

    Args:
        folder: A folder on the disk.
        needed: Space needed [bytes].
        purpose: Its use, for the message.

    Raises:
        DiskFull: If there is less.
    """
    free = free_bytes(folder)
    if free < needed:
        raise DiskFull(
            f"{folder}: {readable(free)} are free, {purpose} needs {readable(needed)}; "
            "make room, then resume the capture."
        )


def free_bytes(folder: Path) -> int:
    """Space that this user may still write [bytes]."""
    return shutil.disk_usage(folder).free


def is_full(problem: BaseException) -> bool:
    """Whether an error, or one of its causes, is a full disk."""
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
