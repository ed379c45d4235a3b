"""The choice of a cluster, by options of the command line, and the hosts of `--ssh hosts.txt`."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

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


Kind = Literal["local", "running", "slurm", "kubernetes", "ssh"]

PATIENCE_S: Mapping[Kind, float] = {
    "local": 300.0,
    "running": 300.0,
    "ssh": 300.0,
    "slurm": 24 * 3600.0,
    "kubernetes": 3600.0,
}
"""How long a worker may be awaited: jobs wait in their queue, and machines for pods have to start and load images."""
MAX_WORKERS = 10_000
MIN_MEMORY_GIB, MAX_MEMORY_GIB = 0.25, 65536.0
_ADDRESS = re.compile(r"(tcp|tls)://(\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9._-]{1,253}):([0-9]{1,5})")


@dataclass(frozen=True)
class ClusterChoice:
    """The cluster that the command line asks for; without anything, this machine."""

    address: str | None = None
    """`--cluster`: a scheduler that runs already, as tcp://host:port or tls://host:port."""
    workers: int | None = None
    """How many; None: one for each core of this machine, fewer if memory is short, or one job, or one pod."""
    memory_gib: float | None = None
    """Memory of each worker [GiB]; None: what is free, shared out, or what Dask's configuration says."""
    slurm: bool = False
    kubernetes: bool = False
    ssh: Path | None = None
    """A file with one host in each line, and comments after #."""
    tls: Path | None = None
    """A folder with ca.pem, cert.pem and key.pem, for an address that begins with tls://."""


def kind_of(choice: ClusterChoice) -> Kind:
    """The kind of cluster, of a choice that was checked."""
    if choice.address is not None:
        return "running"
    if choice.slurm:
        return "slurm"
    if choice.kubernetes:
        return "kubernetes"
    return "local" if choice.ssh is None else "ssh"


def patience_of(choice: ClusterChoice) -> float:
    """How long a batch waits where no worker is there [s]."""
    return PATIENCE_S[kind_of(choice)]


def check_choice(choice: ClusterChoice) -> None:
    """Check that a choice means one cluster; nothing is started or asked.

    Raises:
        OptionError: If options contradict each other, a number cannot be meant, or the file of hosts is unfit.
    """
    said = {
        "--cluster": choice.address is not None,
        "--slurm": choice.slurm,
        "--kubernetes": choice.kubernetes,
        "--ssh": choice.ssh is not None,
    }
    kinds = [name for name, given in said.items() if given]
    if len(kinds) > 1:
        raise OptionError(
            f"{' and '.join(kinds)}: found {len(kinds)} kinds of clusters, expected one; leave out others."
        )
    _check_sizes(choice, kinds)
    if choice.address is not None:
        _check_address(choice)
    elif choice.tls is not None:
        raise OptionError(
            "--tls: goes with --cluster tls://host:port only; the other clusters make their certificates."
        )
    if choice.ssh is not None:
        read_hosts(choice.ssh)


def _check_sizes(choice: ClusterChoice, kinds: list[str]) -> None:
    workers, memory = choice.workers, choice.memory_gib
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise OptionError(f"--workers: found {workers}, expected 1 ... {MAX_WORKERS}.")
    if memory is not None and not (math.isfinite(memory) and MIN_MEMORY_GIB <= memory <= MAX_MEMORY_GIB):
        raise OptionError(f"--memory-gib: found {memory:g}, expected {MIN_MEMORY_GIB:g} ... {MAX_MEMORY_GIB:g}.")
    if workers is not None and kinds == ["--ssh"]:
        raise OptionError(
            "--workers: does not go with --ssh; each line of the file is one worker, so repeat a host there."
        )
    if kinds == ["--cluster"]:
        for name, value in (("--workers", workers), ("--memory-gib", memory)):
            if value is not None:
                raise OptionError(f"{name}: does not go with --cluster; a running cluster has its workers.")


def _check_address(choice: ClusterChoice) -> None:
    found = _ADDRESS.fullmatch(choice.address or "")
    if found is None or not 1 <= int(found[3]) <= 65535:
        raise OptionError(f"--cluster: found {choice.address!r:.100}, expected tcp://host:port or tls://host:port.")
    if choice.tls is not None and found[1] != "tls":
        raise OptionError(f"--tls: goes with an address tls://, found {choice.address}.")
    if choice.tls is None and found[1] == "tls":
        raise OptionError("--cluster tls://: needs --tls FOLDER with ca.pem, cert.pem and key.pem.")
