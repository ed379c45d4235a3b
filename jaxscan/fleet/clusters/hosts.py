"""The machines of `--ssh hosts.txt`: one in each line."""

import re
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import OptionError
from jaxscan.files.disk import read_bounded, shown


MAX_BYTES = 1 << 18
MAX_LINES = 1000
# What SSH or a shell could take for something else, as an option or a command, is no part of a name.
_HOST = re.compile(
    r"(?:([A-Za-z_][A-Za-z0-9._-]{0,63})@)?"
    r"([A-Za-z0-9](?:[A-Za-z0-9._-]{0,252})|\[[0-9A-Fa-f:.]{2,45}\])"
    r"(?::([0-9]{1,5}))?"
)


class Host(NamedTuple):
    """A machine, and how SSH gets there; what is None is as in ~/.ssh/config."""

    name: str
    user: str | None = None
    port: int | None = None


def read_hosts(path: str | Path) -> tuple[Host, ...]:
    """The host of each line, in the file's order; one that is there twice gets two workers.

    Args:
        path: A text file. A line is `host`, `user@host` or `user@host:port`; what follows # is a comment.

    Raises:
        OptionError: If the file cannot be read, is too large, names no host, or a line is none.
    """
    try:
        text = read_bounded(path, MAX_BYTES, error=OptionError).decode()
    except UnicodeDecodeError as problem:
        raise OptionError(f"{shown(path)}: is no text; expected one host in each line.") from problem
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    hosts = tuple(_host(line, f"{shown(path)}: line {k}") for k, line in enumerate(lines, 1) if line)
    if not hosts:
        raise OptionError(f"{shown(path)}: names no host; expected one in each line, as user@host or host:22.")
    if len(hosts) > MAX_LINES:
        raise OptionError(f"{shown(path)}: names {len(hosts)} hosts, expected at most {MAX_LINES}.")
    return hosts


def _host(line: str, where: str) -> Host:
    found = _HOST.fullmatch(line)
    port = int(found[3]) if found and found[3] else None
    if found is None or (port is not None and not 1 <= port <= 65535):
        raise OptionError(f"{where}: found {line!r:.100}, expected host, user@host or user@host:port.")
    return Host(found[2].strip("[]"), found[1], port)
