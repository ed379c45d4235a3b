"""A capture that appears under its name only when it is complete."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.disk import check_name, partial_folder, reported, sync_to_disk


@contextlib.contextmanager
def whole_capture(target: Path) -> Iterator[Path]:
    """A folder in work, which becomes `target` at the end, and of which nothing is left after an error.

    Yields:
        Its path.

    Raises:
        CaptureError: If the target exists or cannot be written.
    """
    target = Path(os.path.abspath(target))
    check_new_folder(target)
    with reported(f"{target}: cannot be created", error=CaptureError), partial_folder(target) as part:
        yield part
        # Check again: a folder may have appeared in the meantime.
        check_new_folder(target)
        # Wait for the disk here, once, so that the source may be deleted afterwards.
        for place, _, names in os.walk(part):
            for name in (*names, ""):
                sync_to_disk(Path(place, name))
        os.rename(part, target)
        sync_to_disk(target.parent)


def check_new_folder(target: str | Path) -> None:
    """Check that a folder can be made under this name.

    Raises:
        CaptureError: If something exists there, or its own folder does not.
    """
    target = Path(os.path.abspath(target))
    check_name(target, error=CaptureError)
    if os.path.lexists(target):
        raise CaptureError(f"{target}: exists; choose another folder, a capture is never overwritten.")
    if not os.path.isdir(target.parent):
        raise CaptureError(f"{target}: cannot be created, the folder {target.parent} does not exist; create it first.")
