"""The folder of a new capture: only where no other data is lost."""

import os
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME


LOCK_NAME = ".scan.lock"
"""Lock file in a folder during a capture."""


def require_no_links(path: Path) -> None:
    """Check that nothing can be written outside the folder of a capture.

    Raises:
        CaptureError: If a folder of images, the journal or the header is a link.
    """
    for name in ("on", "off", JOURNAL_NAME, HEADER_NAME):
        if os.path.islink(path / name):
            raise CaptureError(
                f"{path / name}: found a link, which may lead anywhere, expected the capture's own; "
                "nothing is written there."
            )


def is_unused(path: Path) -> bool:
    """Whether a folder is empty, or holds only a capture that was begun and has no header yet."""
    for entry in path.iterdir():
        if entry.name.startswith(".part-") or entry.name == LOCK_NAME:
            continue
        if entry.name not in ("on", "off", JOURNAL_NAME):
            return False
        if any(entry.iterdir()) if entry.is_dir() else entry.stat().st_size > 0:
            return False
    return True
