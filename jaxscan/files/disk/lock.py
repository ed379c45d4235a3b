"""A lock file that admits one program per folder; a program that has died holds it no longer."""

import contextlib
import errno
import io
import json
import os
import re
import socket
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.writing import open_to_write


try:
    import fcntl
except ImportError:  # Not on Windows; there the file's content alone decides.
    fcntl = None  # type: ignore[assignment]

_MAX_BYTES = 4096
# A lock of this library, perhaps cut off because its writer died. Any other text is someone's own file, not a lock.
_OURS = re.compile(rb"([{][^\n]*|\[\]|[0-9]+ on [^\n]*\n?)?\0*")
_NO_LOCKS = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}


class Holder(NamedTuple):
    """The process that holds a folder."""

    pid: int
    host: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


class FolderLock:
    """Holds a folder until the end of `with`, or of the process.

    The system's lock on the file decides between programs of this machine, and is free when its holder has died. A
    holder on another machine, or on a disk without locks, counts as alive until a person deletes the file. No link
    is followed.
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
        """Says whose lock was taken over; "" if none was."""
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

    def __exit__(self, *exception: object) -> None:
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
            # A living holder on this machine would have the system's lock.
            strange = holder is not None and (state == "unknown" or holder.host != socket.gethostname())
            if state == "theirs" or (not created and strange):
                remedy = f"if that one has ended, delete {self.path}" if strange else self._remedy
                busy = self._busy.format(holder or "another program")
                raise self._error(f"{self.path.parent}: {busy}; {remedy}.")
            if not created:
                self.note = f"took over the lock of {holder or 'a program'}, which has ended"
            os.ftruncate(file.fileno(), 0)
            os.pwrite(file.fileno(), json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode(), 0)
            os.fsync(file.fileno())
        except BaseException:
            with contextlib.suppress(OSError):
                file.close()
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


def _holder(text: bytes) -> Holder | None:
    """The holder that a lock file names; None if it is empty or unreadable: its writer died while writing."""
    try:
        value: Any = json.loads(text)
        return Holder(int(value["pid"]), str(value["host"]))
    except (ValueError, KeyError, TypeError):
        return None
