"""The folder of a project's products: one project writes there, and one batch at a time."""

import contextlib
import errno
import io
import json
import os
import platform
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

from jaxscan.errors import ConfigError
from jaxscan.files.disk import (
    MEGABYTE,
    is_outside,
    make_folder,
    open_to_write,
    parse_json,
    read_bounded,
    reported,
    write_atomically,
)
from jaxscan.project.project import Project


try:
    import fcntl
except ImportError:  # Not on Windows; there nothing is locked.
    fcntl = None  # type: ignore[assignment]


FORMAT = "jaxscan-products/1"
ABOUT, LOCK = "project.json", ".batch.lock"
MOST_LOCK = 4096


@contextlib.contextmanager
def claimed(project: Project, named: Path | None = None) -> Iterator[None]:
    """Make the folder of the products this project's, and keep other batches out until the end of `with`.

    Args:
        project: The project, whose file may come from a stranger.
        named: The folder of the products as the user names it: where it lies outside of the project's, the first batch
            needs the user's own word.

    Raises:
        ConfigError: If it belongs to another project, is not the one that was named, lies outside and was not named,
            another batch is at work, or it cannot be written.
    """
    output = project.output
    _check_outside(project, named)
    with contextlib.ExitStack() as stack:
        with reported(f"{output}: cannot be written", error=ConfigError):
            make_folder(output)
            with reported(f"{output / LOCK}: cannot be written", error=ConfigError):
                lock = stack.enter_context(_opened(output / LOCK))
            _take(lock.fileno(), output)
            _take_over(project)
            os.ftruncate(lock.fileno(), 0)
            lock.write(f"{os.getpid()} on {platform.node()}\n".encode())
        yield


def _opened(path: Path) -> io.FileIO:
    """The file of the lock; its content is lost, so it must be one that a batch wrote.

    Raises:
        OSError: If it cannot be opened, is a link, a device or a pipe, or holds something else.
    """
    lock = open_to_write(path, "append")
    try:
        if not re.fullmatch(rb"(\d+ on [^\n]*\n?)?\0*", os.pread(lock.fileno(), MOST_LOCK, 0)):
            raise OSError("found something that is no lock of a batch; move it away")
    except BaseException:
        lock.close()
        raise
    return lock


def _take(handle: int, output: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        who = read_bounded(output / LOCK, MEGABYTE, error=ConfigError).decode(errors="replace").strip()
        raise ConfigError(
            f"{output}: another batch is writing here (process {who or 'unknown'}); wait for it, or end it."
        ) from None
    except OSError as problem:
        # Some disks of clusters have no locks; there nobody is kept out.
        if problem.errno not in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
            raise


def _is_another(other: str, own: str) -> bool:
    """Whether a file is there and is not this one, by another path."""
    try:
        return not os.path.samefile(other, own)
    except (OSError, ValueError):
        return False


def _check_outside(project: Project, named: Path | None) -> None:
    """Check that a folder outside of the project's is named by the user, or is known to be this project's.

    All links are followed: a link in place of the folder leads outside too.
    """
    output, home = project.output, project.file.parent
    if named is not None:
        if os.path.realpath(named) != os.path.realpath(output):
            raise ConfigError(f"{named}: is not the folder of the products, which {project.file} says is {output}.")
    elif is_outside(output, home) and _owner(project) != str(project.file):
        raise ConfigError(
            f"{project.file}: output: {output} is outside of {home}, where a project writes only what you allow: "
            f"call it once with {shlex.join(['--output', os.path.realpath(output)])}."
        )


def check_owner(project: Project) -> None:
    """Check that the folder of the products is not another project's.

    A project whose folder was moved is still the same; two files that are there are two projects.

    Raises:
        ConfigError: If it belongs to another one.
    """
    other = _owner(project)
    if other is not None and other != str(project.file) and _is_another(other, str(project.file)):
        raise ConfigError(f"{project.output}: holds the products of another project, {other}; choose another `output`.")


def _take_over(project: Project) -> None:
    check_owner(project)
    own = str(project.file)
    if _owner(project) != own:
        about = {"format": FORMAT, "project": project.wanted.project.name, "file": own}
        text = json.dumps(about, indent=2) + "\n"
        write_atomically(project.output / ABOUT, text.encode(), error=ConfigError, links="replace")


def _owner(project: Project) -> str | None:
    path = project.output / ABOUT
    if not os.path.lexists(path):
        return None
    content = read_bounded(path, MEGABYTE, error=ConfigError, links="refuse")
    about = parse_json(content, name=str(path), error=ConfigError)
    other = about.get("file") if isinstance(about, dict) else None
    return other if isinstance(other, str) else None
