"""Folders that appear with all their files, and of which nothing is left where they could not be completed."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from jaxscan.files.disk.partial import Part, partial_folder
from jaxscan.files.disk.writing import make_folder, sync_to_disk


@contextlib.contextmanager
def whole_folder(target: str | Path, *, durable: bool = True) -> Iterator[Part]:
    """A folder in work; its files get their names in `target` when all of them are complete.

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
    # In the folder itself where there is one, which may be a disk of its own.
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
