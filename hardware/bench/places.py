"""The bench's folders and locks, and its own errors, which are kept apart from those of the rig that it simulates."""

import fcntl
import os
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxscan.errors import JaxscanError


class BenchError(JaxscanError):
    """A tool is missing, a build failed, or a part of the bench does not answer."""


HERE = Path(__file__).resolve().parent
WORLD = HERE / "camera" / "world.toml"
TWO_LASERS = HERE / "camera" / "world_two_lasers.toml"
"""A rig like that of `WORLD`, with a second laser."""


def runtime() -> Path:
    """The folder of the bench that `make bench` runs; fixed, because configs/bench.toml names the port in it."""
    return Path(os.environ.get("JAXSCAN_BENCH") or HERE / "build" / "desk")


_OPEN = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


@contextmanager
def held(path: Path, *, timeout_s: float, busy: str) -> Iterator[None]:
    """Holds a lock file in a folder of `own_folder`; the system frees the lock of a process that has died.

    Raises:
        BenchError: If another process keeps it longer than `timeout_s`, with the message `busy`, or if it is no plain
            file of this user.
    """
    try:
        file = os.open(path, _OPEN, 0o600)
    except OSError as problem:
        raise BenchError(f"{path}: cannot be used as a lock: {problem.strerror}; delete it.") from problem
    try:
        found = os.fstat(file)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid():
            raise BenchError(f"{path}: cannot be used as a lock: expected a plain file of this user; delete it.")
        limit = time.monotonic() + timeout_s
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > limit:
                    raise BenchError(busy) from None
                time.sleep(0.05)
        yield
    finally:
        os.close(file)


def own_folder(folder: Path) -> Path:
    """Make a folder for this user alone. Raises BenchError if there is a link, a file, or a folder open to others."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = os.lstat(folder)
    except OSError as problem:
        raise BenchError(f"{folder}: cannot be made: {problem.strerror}.") from problem
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise BenchError(f"{folder}: expected a folder of this user that nobody else may write to; delete it.")
    return folder


def private_folder() -> Path:
    """This user's folder for files that last no longer than a login: in XDG_RUNTIME_DIR, or in the temporary folder."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and os.path.isabs(runtime) and os.path.isdir(runtime):
        return own_folder(Path(runtime) / "jaxscan")
    return own_folder(Path(tempfile.gettempdir()) / f"jaxscan-{os.getuid()}")
