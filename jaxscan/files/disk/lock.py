"""A lock file that admits one program per folder; a program that has died holds it no longer."""

import contextlib
import errno
import io
import json
import os
import re
import socket
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.reading import MEGABYTE, open_regular
from jaxscan.files.disk.writing import open_to_write


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


try:
    import fcntl
except ImportError:  # Not on Windows; there the file's content alone decides.
    fcntl = None  # type: ignore[assignment]

_MAX_BYTES = 4096
# Ours, or the beginning of one whose writer died; a text of somebody else, as by another name of his file, is no lock.
_OURS = re.compile(rb"([{][^\n]*|\[\]|[0-9]+ on [^\n]*\n?)?\0*")
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

    The file is made where there is none; if it exists already, its holder is looked up. The system's lock on the file
    decides between two programs that find the file of the same dead process. No link is followed.
    """

    def __init__(self, path: Path, *, error: type[JaxscanError], busy: str, remedy: str) -> None:
        """A lock that is not held yet.

        Args:
            path: The lock file, in the folder that it holds.
            error: Type of the error that `with` raises where the folder cannot be written, or another one holds it.
            busy: What the folder then is, with {} for who holds it, such as "in use by {}".
            remedy: What the user may do then.
        """
        self.path = path
        self.note = ""
        """Whose lock was taken over; "" if none."""
        self._error, self._busy, self._remedy = error, busy, remedy
        self._file: io.FileIO | None = None

    def __enter__(self) -> "FolderLock":
        try:
            while not self._take():
                pass
        except OSError as problem:
            raise self._error(
                f"{self.path}: cannot be written: {problem.strerror or problem}; choose another folder."
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
        self._file.close()
        self._file = None

    def _take(self) -> bool:
        """Take the lock; False if the file vanished meanwhile."""
        created = True
        try:
            file = open_to_write(self.path, "make", mode=0o644)
        except FileExistsError:
            created = False
            try:
                file = open_to_write(self.path, "change")
            except FileNotFoundError:
                return False
        try:
            state = _lock(file.fileno())
            if not self._still_there(file.fileno()):
                file.close()
                return False
            text = os.pread(file.fileno(), _MAX_BYTES, 0)
            if not _OURS.fullmatch(text):
                raise OSError("found something that is no lock of a program, expected none; move it away")
            holder = _holder(text)
            if state == "theirs" or (not created and holder is not None and not _gone(holder, state)):
                raise self._error(self._in_use(holder))
            if not created:
                self.note = f"took over the lock of {holder or 'a program'}, which has ended"
            os.ftruncate(file.fileno(), 0)
            os.pwrite(file.fileno(), json.dumps(vars(_me())).encode(), 0)
            os.fsync(file.fileno())
        except BaseException:
            with contextlib.suppress(OSError):
                file.close()
            raise
        self._file = file
        return True

    def _in_use(self, holder: Holder | None) -> str:
        busy = f"{self.path.parent}: {self._busy.format(holder or 'another program')}"
        if holder is not None and holder.host != socket.gethostname():
            return f"{busy}; if that one has ended, delete {self.path}."
        return f"{busy}; {self._remedy}."

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


def _holder(text: bytes) -> Holder | None:
    """The holder that a lock file names; None if it is empty or unreadable: its writer died while writing."""
    try:
        value: Any = json.loads(text)
        return Holder(int(value["pid"]), str(value["host"]), str(value["start"]))
    except (ValueError, KeyError, TypeError):
        return None


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
