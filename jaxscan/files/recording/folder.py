"""The folder that a capture is written into: made so that it lasts, and nobody else's."""

import contextlib
import os
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.capture import JOURNAL_NAME
from jaxscan.files.disk import sync_to_disk


LOCK_NAME = ".scan.lock"
"""File that whoever captures into a folder keeps there meanwhile."""


def make_folder(path: Path, *, durable: bool) -> None:
    """Make a folder, and those above it that are missing; none is lost with the power.

    Raises:
        OSError: If it cannot be made.
    """
    new = [path, *(above for above in path.parents if not above.exists())]
    path.mkdir(parents=True, exist_ok=True)
    if durable and os.name == "posix":
        for folder in new:
            # A folder that may be written but not listed cannot be waited for.
            with contextlib.suppress(PermissionError):
                sync_to_disk(folder.parent)


def require_no_links(path: Path) -> None:
    """See that what is written into a capture stays in its folder.

    Raises:
        CaptureError: If a folder of images or the journal is a link.
    """
    for name in ("on", "off", JOURNAL_NAME):
        if (path / name).is_symlink():
            raise CaptureError(
                f"{path / name}: found a link, which may lead anywhere, expected the capture's own; "
                "nothing is written there."
            )


def is_unused(path: Path) -> bool:
    """Whether nothing is lost with this folder: it is empty, or a capture was begun and has not even a header."""
    empty = {"on": True, "off": True, JOURNAL_NAME: True, LOCK_NAME: True}
    for entry in path.iterdir():
        if entry.name.startswith(".part-") or entry.name == LOCK_NAME:
            continue
        if entry.name not in empty:
            return False
        if any(entry.iterdir()) if entry.is_dir() else entry.stat().st_size > 0:
            return False
    return True
