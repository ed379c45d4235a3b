"""The lock of a capture's folder: one session writes there."""

from pathlib import Path

from jaxscan.files.disk import FolderLock
from jaxscan.files.recording import LOCK_NAME
from scanrig.errors import SessionError


def folder_lock(folder: Path) -> FolderLock:
    """The lock of a folder, which is not held yet; it raises `SessionError` where another session has it."""
    remedy = "wait for it, or choose another folder"
    return FolderLock(folder / LOCK_NAME, error=SessionError, busy="in use by {}", remedy=remedy)
