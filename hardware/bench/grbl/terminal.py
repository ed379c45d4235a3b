"""A pseudo terminal under a name that stays the same."""

import os
import select
import tty
from pathlib import Path


class Terminal:
    """Two ends: the program's, which is used here, and the one that a host opens by name."""

    def __init__(self, name: str) -> None:
        """Open it; `name` becomes a link to the host's end."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self._link = Path(name)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(self._theirs))

    def wait(self, timeout_s: float) -> bool:
        """Whether something has come within a time; False once it is closed."""
        try:
            return bool(select.select([self._ours], [], [], timeout_s)[0])
        except (OSError, ValueError):
            return False

    def read(self) -> bytes:
        """Received bytes."""
        return os.read(self._ours, 4096)

    def write(self, data: bytes) -> None:
        """Send it."""
        os.write(self._ours, data)

    def close(self) -> None:
        """Pull the cable."""
        os.close(self._ours)
        os.close(self._theirs)
        self._ours = -1
        self._link.unlink(missing_ok=True)
