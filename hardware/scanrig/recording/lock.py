"""A lock file that admits one program per folder; a program that has died holds it no longer."""

import contextlib
import errno
import json
import os
import socket
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from jaxscan.files.recording import LOCK_NAME
from scanrig.errors import SessionError


try:
    import fcntl
except ImportError:  # Not on Windows; there the file's content alone decides.
    fcntl = None  # type: ignore[assignment]

_MAX_BYTES = 4096
# A link in a folder made by somebody else may point anywhere.
_OPEN = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)
_NO_LOCKS = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}


@dataclass(frozen=True)
class Holder:
    """The process that holds a folder."""

    pid: int
    host: str
    start: str
    """Start of the process, as the system tells it: process numbers are used again."""

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


class FolderLock:
    """Holds a folder until the end of `with`, or of the process.

    The file is created with O_EXCL; if it exists already, its holder is looked up. The system's lock on the file
    decides between two programs that find the file of the same dead process.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOCK_NAME
        self.note = ""
        """Whose lock was taken over; "" if none."""
        self._file: int | None = None

    def __enter__(self) -> "FolderLock":
        try:
            while not self._take():
                pass
        except OSError as problem:
            raise SessionError(
                f"{self.path.parent}: cannot be written: {problem.strerror or problem}; choose another folder."
            ) from problem
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is None:
            return
        # Unlinked while still locked: a program that opened it meanwhile sees that the name is gone and starts again.
        with contextlib.suppress(OSError):
            self.path.unlink()
        os.close(self._file)
        self._file = None

    def _take(self) -> bool:
        """Take the lock; False if the file vanished meanwhile."""
        created = True
        try:
            file = os.open(self.path, _OPEN | os.O_CREAT | os.O_EXCL, 0o644)
        except FileExistsError:
            created = False
            try:
                file = os.open(self.path, _OPEN)
            except FileNotFoundError:
                return False
        try:
            state = _lock(file)
            if not self._still_there(file):
                os.close(file)
                return False
            holder = _read(file)
            if state == "theirs" or (not created and holder is not None and not _gone(holder, state)):
                raise SessionError(_in_use(self.path, holder))
            if not created:
                self.note = f"took over the lock of {holder or 'a program'}, which has ended"
            me = json.dumps(vars(_me())).encode()
            os.ftruncate(file, 0)
            os.pwrite(file, me, 0)
            os.fsync(file)
        except BaseException:
            with contextlib.suppress(OSError):
                os.close(file)
            raise
        self._file = file
        return True

    def _still_there(self, file: int) -> bool:
        try:
            return os.path.samestat(os.stat(self.path), os.fstat(file))
        except FileNotFoundError:
            return False


def _lock(file: int) -> Literal["ours", "theirs", "unknown"]:
    """Take the system's lock on a file; "unknown" if the file system has no locks."""
    if fcntl is None:
        return "unknown"
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return "theirs"
    except OSError as problem:
        if problem.errno not in _NO_LOCKS:
            raise
        return "unknown"
    return "ours"


def _read(file: int) -> Holder | None:
    """The holder named in the file; None if it is empty or unreadable: its writer died while writing."""
    try:
        value: Any = json.loads(os.pread(file, _MAX_BYTES, 0))
        return Holder(int(value["pid"]), str(value["host"]), str(value["start"]))
    except (ValueError, KeyError, TypeError):
        return None


def _in_use(path: Path, holder: Holder | None) -> str:
    if holder is not None and holder.host != socket.gethostname():
        return f"{path.parent}: in use by {holder}; if that one has ended, delete {path}."
    return f"{path.parent}: in use by {holder or 'another program'}; wait for it, or choose another folder."


def _me() -> Holder:
    return Holder(os.getpid(), socket.gethostname(), _start_of(os.getpid()) or "")


def _gone(holder: Holder, state: str) -> bool:
    """Whether the holder is known to have ended."""
    if holder.host != socket.gethostname():
        return False
    if state == "ours":
        return True  # A living holder would have the system's lock.
    try:
        os.kill(holder.pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        pass  # The process exists and belongs to another user.
    start = _start_of(holder.pid)
    return bool(start and holder.start) and start != holder.start


def _start_of(pid: int) -> str | None:
    """Boot id and start time of a process; None if the system does not tell."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        # The program's name may contain brackets and spaces.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return f"{boot} {fields[19]}"
    except (OSError, IndexError, UnicodeDecodeError):
        return None
