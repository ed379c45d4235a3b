"""What this process asks of the system while a case runs: files elsewhere, other machines, other programs."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_PATHS = {
    "os.mkdir": 1,
    "os.remove": 1,
    "os.rename": 2,
    "os.rmdir": 1,
    "os.truncate": 1,
    "os.chmod": 1,
    "os.chown": 1,
    "os.link": 2,
    "os.symlink": 2,
    "os.utime": 1,
    "sqlite3.connect": 1,
}
"""Events that change the disk, and how many of their arguments are paths."""
_NETWORK = {"socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto"}
_PROGRAMS = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.forkpty"}


class Watch:
    """Hears all audit events; an audit hook can never be taken away, so there is one in a process."""

    def __init__(self, allowed: tuple[Path, ...]) -> None:
        """`allowed`: folders that may be written to in any case, such as that of compiled code."""
        self._allowed = tuple(os.path.realpath(folder) for folder in allowed)
        self._folder = ""
        self._found: dict[str, set[str]] | None = None
        self._busy = threading.local()
        sys.addaudithook(self._hear)

    @contextmanager
    def watching(self, folder: Path) -> Iterator[dict[str, set[str]]]:
        """Collect events until the end of `with`, by their kind: "outside", "network", "program"."""
        self._folder, self._found = os.path.realpath(folder), {}
        try:
            yield self._found
        finally:
            self._found = None

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self._found is None or getattr(self._busy, "on", False):
            return
        self._busy.on = True
        try:
            if event in _NETWORK:
                self._note("network", f"{event} {arguments[1:] if event != 'socket.getaddrinfo' else arguments[:2]}")
            elif event in _PROGRAMS:
                self._note("program", f"{event} {str(arguments)[:200]}")
            elif event == "open":
                path, _, flags = arguments
                if isinstance(flags, int) and flags & _WRITES:
                    self._look(event, path)
            elif event in _PATHS:
                for path in arguments[: _PATHS[event]]:
                    self._look(event, path)
        finally:
            self._busy.on = False

    def _look(self, event: str, path: Any) -> None:
        if not isinstance(path, str | bytes | os.PathLike):
            return
        try:
            real = os.path.realpath(os.fsdecode(path))
        except (OSError, ValueError):
            # It names no place, so nothing is written there.
            return
        inside = any(f"{real}/".startswith(f"{root}/") for root in (self._folder, *self._allowed))
        if not inside and not real.startswith(("/dev/", "/proc/")) and not str(path).startswith((":memory:", "file:")):
            self._note("outside", f"{event} {real}")

    def _note(self, kind: str, what: str) -> None:
        if self._found is not None:
            self._found.setdefault(kind, set()).add(what)
