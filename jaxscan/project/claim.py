"""The folder of a project's products: one project writes there, and one batch at a time."""

import contextlib
import json
import os
import shlex
from collections.abc import Iterator
from pathlib import Path

from jaxscan.errors import ConfigError
from jaxscan.files.disk import (
    MEGABYTE,
    FolderLock,
    is_outside,
    make_folder,
    parse_json,
    read_bounded,
    reported,
    write_atomically,
)
from jaxscan.project.project import Project


FORMAT = "jaxscan-products/1"
ABOUT, LOCK = "project.json", ".batch.lock"


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
    with reported(f"{output}: cannot be written", error=ConfigError):
        make_folder(output)
    busy, remedy = "another batch is writing here ({})", "wait for it, or end it"
    with FolderLock(output / LOCK, error=ConfigError, busy=busy, remedy=remedy):
        _take_over(project)
        yield


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
