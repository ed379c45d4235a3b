"""Places on storage behind fsspec, and requests to it that are tried again."""

import concurrent.futures
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

from jaxscan.errors import CaptureError, DependencyError, JaxscanError
from jaxscan.files.disk import shown


WORKERS = 8
"""Files that are read at the same time."""
WAITS_S = (0.1, 0.3, 0.9, 2.7)
"""Pauses between the tries of one request [s]."""

_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_PASSWORD = re.compile(r"[^:/]+://[^/]*:[^/]*@")
_S3 = ("s3", "s3a")
# Another try would have the same answer.
_FINAL = (PermissionError, IsADirectoryError, NotADirectoryError, ValueError, TypeError, NotImplementedError)

Item = TypeVar("Item")
Result = TypeVar("Result")


class Missing(CaptureError):
    """There is nothing at an address."""


@dataclass(frozen=True, slots=True)
class Place:
    """A file or a folder on storage."""

    storage: Any
    """The file system of fsspec; used by many threads."""
    path: str
    """As the file system calls it."""
    address: str
    """As the user calls it."""

    def child(self, name: str) -> "Place":
        address = self.address if self.address.endswith("/") else self.address + "/"
        return Place(self.storage, f"{self.path.rstrip('/')}/{name}", address + name)


def is_remote(address: str) -> bool:
    """Whether a text has a scheme, such as "s3://"; a path, also one with the letter of a drive, has none."""
    return _ADDRESS.match(address) is not None


def is_s3(address: str) -> bool:
    """Whether an address is one of S3, or of a server that speaks its language."""
    return address.split("://")[0] in _S3


def open_place(address: str) -> Place:
    """The place at an address; nothing is asked of it.

    Raises:
        CaptureError: If the address is none, or has no known scheme.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    check_address(address)
    scheme = address.split("://")[0]
    extra = "s3" if is_s3(address) else "fleet"
    try:
        from fsspec.core import url_to_fs
    except ImportError as problem:
        raise DependencyError(f'{scheme}:// needs fsspec: pip install "jaxscan[{extra}]"') from problem
    try:
        storage, path = _tried(lambda: url_to_fs(address), f"{shown(address)}: cannot be opened")
    except ImportError as problem:
        remedy = f'it needs s3fs: pip install "jaxscan[{extra}]"' if extra == "s3" else _cause(problem)
        raise DependencyError(f"{scheme}:// cannot be opened: {remedy}") from problem
    return Place(storage, path.rstrip("/") or path, address)


def check_address(address: str) -> None:
    """Check that an address has a scheme, leads to one storage, and holds no password.

    Raises:
        CaptureError: If it has not, or does.
    """
    # A chain of file systems may lead anywhere; a password would be in every message and in the catalogue.
    if not is_remote(address) or "::" in address:
        raise CaptureError(f"{shown(address)}: found no address of storage, expected one such as s3://bucket/folder.")
    if _PASSWORD.match(address):
        scheme = address.split("://")[0]
        raise CaptureError(f"{scheme}://…: found a password in an address; give it to the driver by its environment.")


def info_of(place: Place) -> dict[str, Any]:
    """The entry of a file or a folder on storage, with the field names of its driver.

    Raises:
        Missing: If there is none.
        CaptureError: If storage cannot be read.
    """
    return asked(lambda: place.storage.info(place.path), place)


def asked(ask: Callable[[], Result], place: Place) -> Result:
    """The answer of storage about a place, as it is now.

    Raises:
        Missing: If there is nothing.
        CaptureError: If there was no answer.
    """

    def fresh() -> Result:
        place.storage.invalidate_cache(place.path)
        return ask()

    return _tried(fresh, f"{shown(place.address)}: cannot be read")


def _tried(do: Callable[[], Result], failure: str) -> Result:
    """The result of a request, tried again after failures that may pass.

    Raises:
        Missing: If there is nothing.
        CaptureError: `failure` and its cause.
        ImportError: If a driver is missing.
    """
    waits_s = iter(WAITS_S)
    while True:
        try:
            return do()
        except (ImportError, JaxscanError):
            raise
        except FileNotFoundError as problem:
            raise Missing(f"{failure}: no such file or folder.") from problem
        # Every driver has errors of its own for a network that fails.
        except Exception as problem:
            wait_s = None if _is_final(problem) else next(waits_s, None)
            if wait_s is None:
                raise CaptureError(f"{failure}: {_cause(problem)}.") from problem
            time.sleep(wait_s)


def _is_final(problem: Exception) -> bool:
    # The driver of S3 knows few names of refusals; it keeps the answer of the server as the cause.
    answer = getattr(problem.__cause__, "response", None)
    said = answer.get("ResponseMetadata") if isinstance(answer, dict) else None
    refused = isinstance(said, dict) and said.get("HTTPStatusCode") in (401, 403)
    return refused or isinstance(problem, _FINAL)


def _cause(problem: BaseException) -> str:
    """What happened, in one line without the colours and other controls of a terminal."""
    text = "".join(letter if letter.isprintable() else " " for letter in str(problem))
    return f"{' '.join(text.split()) or type(problem).__name__:.300}".rstrip(".")


def in_threads(do: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The results in the order of the items; after the first error no more are begun."""
    with concurrent.futures.ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(do, items))
