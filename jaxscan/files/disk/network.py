"""Whether a folder lies on another computer, whose disk may not know the locks that are held here."""

import os
import re
from pathlib import Path

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.opening import MEGABYTE, open_regular


MOUNTS = Path("/proc/self/mountinfo")
"""The mounted file systems, a line each. Only Linux has it; elsewhere every disk is taken for one of this computer."""
_LONGEST = 16 * MEGABYTE
_KINDS = re.compile(
    r"nfs\d?|cifs|smb\w*|9p|ceph|afs|lustre|glusterfs|beegfs|gpfs|panfs|wekafs|orangefs|pvfs2|gfs2|ocfs2|fuse\..+"
)
_MOUNT_POINT, _AFTER = 4, " - "
"""Number of a line's field, and the mark before the kind of its file system."""


def is_on_network(folder: str | Path, *, mounts: Path = MOUNTS) -> bool:
    """Whether a folder's file system is one of a network; `fuse` systems are taken for such.

    Args:
        folder: An existing folder.
        mounts: The table of the mounted file systems.
    """
    try:
        # The system tells no size of this file.
        with open_regular(mounts, error=JaxscanError) as file:
            table = os.fsdecode(file.read(_LONGEST))
    except (JaxscanError, OSError):
        return False
    folder = Path(os.path.realpath(folder))
    deepest, kind = -1, ""
    for line in table.splitlines():
        fields, _, system = line.partition(_AFTER)
        words, kinds = fields.split(), system.split()
        if len(words) <= _MOUNT_POINT or not kinds:
            continue
        # Spaces and the like are written as octal numbers.
        point = Path(re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), words[_MOUNT_POINT]))
        # Of several at one place, the last one is on top.
        if folder.is_relative_to(point) and len(point.parts) >= deepest:
            deepest, kind = len(point.parts), kinds[0]
    return _KINDS.fullmatch(kind) is not None
