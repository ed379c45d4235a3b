"""A cluster that runs already, by the address of its scheduler."""

import asyncio
import contextlib
import logging
import ssl
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
from distributed.versions import VersionMismatchWarning

from jaxscan.errors import OptionError
from jaxscan.files.disk import MEGABYTE, read_bounded
from jaxscan.fleet.clusters.certificates import paths_in, security_of
from jaxscan.fleet.clusters.choice import ClusterChoice
from jaxscan.fleet.clusters.settings import PINNING, run_apart, wait_for_worker


ANSWER_S = 10.0
"""How long a scheduler may take to answer, and after it the first worker to be there."""


@contextlib.contextmanager
def open_running(choice: ClusterChoice) -> Iterator[Any]:
    """A client of a running cluster; the cluster stays when `with` ends.

    Raises:
        OptionError: If the files of certificates are unfit, nobody answers, or there is no worker.
    """
    security = security_from(choice.tls) if choice.tls is not None else None
    with connected(str(choice.address), security) as client:
        start = f"dask worker {choice.address} --nthreads 1 --preload {PINNING}"
        wait_for_worker(client, ANSWER_S, f"start workers for {choice.address}, such as: {start}")
        yield client


def security_from(folder: Path) -> Any:
    """Dask's `Security` from a folder with ca.pem, cert.pem and key.pem.

    Raises:
        OptionError: If one of them is missing or no PEM file of its kind.
    """
    paths = paths_in(folder)
    for path in paths:
        read_bounded(path, MEGABYTE, error=OptionError)
    security = distributed.Security(**security_of(paths))
    try:
        security.get_connection_args("client")
    except (ssl.SSLError, OSError) as problem:
        raise OptionError(f"--tls {folder}: holds no certificates that belong together: {problem}.") from problem
    return security


@contextlib.contextmanager
def connected(address: str, security: Any = None) -> Iterator[Any]:
    """A client of a scheduler.

    Raises:
        OptionError: If it does not answer in `ANSWER_S`, or refuses.
    """
    _ask(address, security or distributed.Security())
    with warnings.catch_warnings():
        # Versions are compared by `check_versions`, with a line of its own.
        warnings.simplefilter("ignore", VersionMismatchWarning)
        client = distributed.Client(address, security=security, timeout=ANSWER_S, set_as_default=False)
    with client:
        yield client


def _ask(address: str, security: Any) -> None:
    """Ask who is there, because a client would wait for ever for the words of one who says none."""

    async def identity() -> Any:
        async with distributed.rpc(address, connection_args=security.get_connection_args("client")) as there:
            return await there.identity()

    async def within_time() -> Any:
        return await asyncio.wait_for(identity(), ANSWER_S)

    try:
        with _quiet():
            found = run_apart(within_time())["type"]
    # What is no scheduler may answer anything, and Dask has no one error for that.
    except Exception as problem:
        raise OptionError(
            f"--cluster: no scheduler of Dask answers at {address} within {ANSWER_S:g} s, or it does not know this "
            "certificate; look at its address and --tls."
        ) from problem
    if found != "Scheduler":
        raise OptionError(
            f"--cluster: found a {found!r:.40} of Dask at {address}, expected the address of its scheduler."
        )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without Dask's own lines about attempts that failed; ours says it."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
