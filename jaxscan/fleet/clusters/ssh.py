"""Workers on machines that SSH reaches: Dask's own SSH cluster, with certificates that are made for each run."""

import asyncio
import collections
import contextlib
import json
import logging
import secrets
import sys
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import asyncssh
import dask
import distributed
from distributed.deploy.ssh import Scheduler, Worker

from jaxscan.errors import OptionError
from jaxscan.fleet.clusters.certificates import NAMES, Certificates, new_certificates, security_of
from jaxscan.fleet.clusters.choice import ClusterChoice, Host, read_hosts
from jaxscan.fleet.clusters.pinning import WORKERS
from jaxscan.fleet.clusters.settings import LOOPBACK_PAGE, NO_PAGE, OURS, PINNING, run_apart


ANSWER_S = 20.0
"""How long a host may take to let us in."""
_START_S = 60
_SHARE = 0.8
"""Part of a machine's memory that its workers have together, where nobody says more."""


@contextlib.contextmanager
def open_ssh(choice: ClusterChoice) -> Iterator[Any]:
    """A scheduler on the first host, and a worker for each line of the file; all ends with `with`.

    Certificates travel through SSH into a folder on each host that only its user can read, and which is removed
    afterwards; command lines hold its path.

    Raises:
        OptionError: If a host does not let us in, cannot keep the certificates, or has no Python that starts Dask.
    """
    hosts = read_hosts(choice.ssh) if choice.ssh is not None else ()
    _refuse_secrets()
    certificates = new_certificates()
    security = distributed.Security(**security_of(certificates))
    with dask.config.set(OURS), _certificates_on(tuple(dict.fromkeys(hosts)), certificates) as folders:
        scheduler, workers = scheduler_spec(hosts[0], folders), worker_specs(hosts, folders, choice.memory_gib)
        try:
            cluster = distributed.SpecCluster(
                workers, scheduler, security=security, name="jaxscan by SSH", silence_logs=logging.CRITICAL
            )
        # Whatever ends a process on another machine before it says where it is.
        except Exception as problem:
            said = " ".join(str(problem).split())
            raise OptionError(
                f"--ssh: Dask did not start on these hosts ({said:.200}); each needs jaxscan[fleet] for {_python()}, "
                "or set DASK_JAXSCAN__PYTHON to the path of Python there."
            ) from problem
        with cluster, distributed.Client(cluster, set_as_default=False) as client:
            yield client


def scheduler_spec(host: Host, folders: dict[Host, str]) -> dict[str, Any]:
    """What Dask starts as a scheduler, as values that travel in a command line."""
    options = {"protocol": "tls://", "port": 0, "security": _paths(folders[host])}
    options |= {"dashboard": False, "dashboard_address": LOOPBACK_PAGE, "preload": [NO_PAGE]}
    return {
        "cls": Scheduler,
        "options": {
            "address": host.name,
            "connect_options": _login(host),
            "kwargs": options,
            "remote_python": _python(),
        },
    }


def worker_specs(
    hosts: Sequence[Host], folders: dict[Host, str], memory_gib: float | None = None
) -> dict[int, dict[str, Any]]:
    """What Dask starts as workers: one for each line, and those of one host share its cores and its memory."""
    on_host, specs = collections.Counter(hosts), {}
    seen: collections.Counter[Host] = collections.Counter()
    for k, host in enumerate(hosts):
        count, number = on_host[host], seen[host]
        seen[host] += 1
        memory: Any = _SHARE / count if memory_gib is None else f"{memory_gib}GiB"
        options = {
            "protocol": "tls://",
            "nthreads": 1,
            "name": f"{host.user or ''}@{host.name}:{host.port or ''}-{number}",
            "memory_limit": memory,
            "dashboard_address": LOOPBACK_PAGE,
            "dashboard": False,
            "preload": [PINNING, NO_PAGE],
            "env": {WORKERS: str(count)},
            "death_timeout": _START_S,
            "security": _paths(folders[host]),
        }
        specs[k] = {
            "cls": Worker,
            "options": {
                "address": host.name,
                "connect_options": _login(host),
                "kwargs": options,
                "worker_class": "distributed.Nanny",
                "remote_python": _python(),
            },
        }
    return specs


def _python() -> str:
    """Python on the hosts: by the same path as here, if nobody says another."""
    return dask.config.get("jaxscan.python", None) or sys.executable


def _login(host: Host) -> dict[str, Any]:
    # Keys, known hosts and all that is not said here are as for the program ssh, in ~/.ssh.
    said = {"username": host.user, "port": host.port}
    return {"login_timeout": ANSWER_S, "connect_timeout": ANSWER_S} | {k: v for k, v in said.items() if v is not None}


def _paths(folder: str) -> dict[str, Any]:
    return security_of(Certificates(*(f"{folder}/{name}" for name in NAMES)))


def _refuse_secrets() -> None:
    """Dask hands its whole configuration to the hosts in a command line, which every user there can read."""
    if "PRIVATE KEY" in json.dumps(dask.config.config, default=str):
        raise OptionError("--ssh: Dask's configuration holds a private key, which all users of the hosts would see.")


@contextlib.contextmanager
def _certificates_on(hosts: Sequence[Host], certificates: Certificates) -> Iterator[dict[Host, str]]:
    # Nobody can guess the name, so nobody can make the folder before us.
    token = secrets.token_hex(16)
    folders = {host: f"/tmp/jaxscan-{token}-{k}" for k, host in enumerate(hosts)}
    made: set[Host] = set()

    async def put() -> None:
        # All are waited for, so that none makes its folder after those that are there were removed.
        tried = await asyncio.gather(
            *(_put(host, folders[host], certificates, made) for host in hosts), return_exceptions=True
        )
        for host, problem in zip(hosts, tried, strict=True):
            if isinstance(problem, asyncssh.Error | OSError | TimeoutError):
                said = " ".join(str(problem).split()) or type(problem).__name__
                raise OptionError(
                    f"--ssh: {host.name} does not let us in, or no file into /tmp ({said:.150}); try: ssh {host.name}"
                ) from problem
            if problem is not None:
                raise problem

    async def remove() -> None:
        left = list(made)
        tried = await asyncio.gather(*(_remove(host, folders[host]) for host in left), return_exceptions=True)
        for host, problem in zip(left, tried, strict=True):
            if problem is not None:
                warnings.warn(
                    f"{host.name}: certificates stay in {folders[host]}: {problem}", RuntimeWarning, stacklevel=2
                )

    try:
        run_apart(put())
        yield folders
    finally:
        run_apart(remove())


async def _put(host: Host, folder: str, certificates: Certificates, made: set[Host]) -> None:
    async with asyncssh.connect(host.name, **_login(host)) as there, there.start_sftp_client() as files:
        await files.mkdir(folder, asyncssh.SFTPAttrs(permissions=0o700))
        made.add(host)
        for name, text in zip(NAMES, certificates, strict=True):
            async with files.open(f"{folder}/{name}", "xb", asyncssh.SFTPAttrs(permissions=0o600)) as file:
                await file.write(text.encode())


async def _remove(host: Host, folder: str) -> None:
    async with asyncssh.connect(host.name, **_login(host)) as there, there.start_sftp_client() as files:
        await files.rmtree(folder)
