"""Captures on storage behind fsspec: `s3://`, `memory://`, `file://` and what else has a driver.

Storage belongs to others: its listings are checked like any file of a stranger, requests are tried again, and copies
are whole or not there.
"""

import concurrent.futures
import datetime
import fnmatch
import functools
import hashlib
import json
import os
import re
import time
import unicodedata
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from jaxscan.errors import CaptureError, DependencyError, JaxscanError
from jaxscan.files.capture import CACHE_NAME, HEADER_NAME
from jaxscan.files.disk import MEGABYTE, Part, make_folder, reported, shown, write_atomically


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
class StoragePlace:
    """A file or a folder on storage."""

    storage: Any
    """The file system of fsspec; used by many threads."""
    path: str
    """Path in the terms of the file system."""
    address: str
    """Address as the user typed it."""

    def child(self, name: str) -> "StoragePlace":
        address = self.address if self.address.endswith("/") else self.address + "/"
        return StoragePlace(self.storage, f"{self.path.rstrip('/')}/{name}", address + name)


def is_remote(address: str) -> bool:
    """Whether a text has a scheme, such as "s3://"; a path, also one with the letter of a drive, has none."""
    return _ADDRESS.match(address) is not None


def is_s3(address: str) -> bool:
    """Whether an address is one of S3, or of a server that speaks its language."""
    return address.split("://")[0] in _S3


def open_place(address: str) -> StoragePlace:
    """The place at an address, without a request to the storage.

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
    return StoragePlace(storage, path.rstrip("/") or path, address)


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


def info_of(place: StoragePlace) -> dict[str, Any]:
    """The entry of a file or a folder on storage, with the field names of its driver.

    Raises:
        Missing: If there is none.
        CaptureError: If storage cannot be read.
    """
    return asked(lambda: place.storage.info(place.path), place)


def asked(ask: Callable[[], Result], place: StoragePlace) -> Result:
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
    """The error in one line, without the control characters of a terminal."""
    text = "".join(letter if letter.isprintable() else " " for letter in str(problem))
    return f"{' '.join(text.split()) or type(problem).__name__:.300}".rstrip(".")


def in_threads(do: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The results in the order of the items; after the first error no more are begun."""
    with concurrent.futures.ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(do, items))


# Reads blocks of files: by fsspec's driver, and those of S3 by a client that needs less than half its time.
#
# A sweep has hundreds of small images. The client of S3 is used where server, region and keys are all that the driver
# was told, and it gets those of the driver; after its first failure the driver reads all that follows. The driver's
# answers and errors are those that count: the client makes it faster, and changes nothing else.

Reader = Callable[[StoragePlace, int, int], bytes]
"""Reads a file from one byte to another; errors are those of the driver."""

_LASTS = datetime.timedelta(minutes=10)
"""After so much time the driver is asked for its keys again; it renews those that end."""
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")


def reader_of(place: StoragePlace) -> Reader:
    """A function that reads files of the storage of a place, from many threads.

    Raises:
        DependencyError: If the client of S3 is not installed.
    """
    return _reader_of_s3(place) if is_s3(place.address) and _is_plain(place) else by_driver


def by_driver(place: StoragePlace, start: int, end: int) -> bytes:
    """A block of a file, by fsspec's driver."""
    # S3 has no range of no bytes.
    return bytes(place.storage.cat_file(place.path, start=start, end=end)) if end > start else b""


def _is_plain(place: StoragePlace) -> bool:
    """Whether the driver of S3 was told nothing but a server, a region, and keys."""
    driver = place.storage
    config = driver.s3.meta.config
    told = driver.client_kwargs or driver.config_kwargs or driver.s3_additional_kwargs
    special = driver.requester_pays or driver.version_aware or driver.cache_regions or config.use_fips_endpoint
    # Of the profile: virtual hosts, acceleration, another way to sign; an authority for certificates.
    styles = (None, {"addressing_style": "auto"}, {"addressing_style": "path"})
    trusts = driver.session.get_config_variable("ca_bundle") and not driver.s3.meta.endpoint_url.startswith("http://")
    own = config.s3 not in styles or trusts
    signed = driver.anon or config.signature_version == "s3v4"
    keyed = bool(driver.key) == bool(driver.secret) and (driver.key or not driver.token)
    return bool(_BUCKET.fullmatch(_parted(place)[0]) and signed and keyed and not (told or special or own))


def _reader_of_s3(place: StoragePlace) -> Reader:
    try:
        from obstore.store import S3Store
    except ImportError as problem:
        raise DependencyError('s3:// needs obstore: pip install "jaxscan[s3]"') from problem
    driver = place.storage
    server = driver.s3.meta
    known: dict[str, Any] = {} if driver.anon else {"credential_provider": lambda: _keys(driver)}
    store = S3Store(
        _parted(place)[0],
        # All that it would otherwise take from the environment, where the driver may not have looked.
        endpoint=server.endpoint_url,
        aws_endpoint_url_s3=server.endpoint_url,
        region=server.region_name or "us-east-1",
        skip_signature=bool(driver.anon),
        virtual_hosted_style_request=False,
        request_payer=False,
        s3_express=False,
        client_options={
            "allow_http": server.endpoint_url.startswith("http://"),
            "connect_timeout": "10s",
            # A silent line has failed. A slow one has not: this limit is that of a whole request.
            "read_timeout": "60s",
            "timeout": "1 hour",
        },
        # Every request is tried again by the caller.
        retry_config={"max_retries": 0},
        **known,
    )
    failures: list[Exception] = []

    def read(place: StoragePlace, start: int, end: int) -> bytes:
        if end > start and not failures:
            try:
                return bytes(store.get_range(_parted(place)[1], start=start, end=end))
            except FileNotFoundError:
                raise
            # A bucket in another region, a certificate, a key that it cannot spell, or a network that fails.
            except Exception as problem:
                failures.append(problem)
        return by_driver(place, start, end)

    return read


def _parted(place: StoragePlace) -> tuple[str, str]:
    bucket, _, key = place.path.partition("/")
    return bucket, key


def _keys(driver: Any) -> dict[str, Any]:
    """The keys with which the driver signs: those that it was given, or else those that its session finds."""
    if driver.key:
        return _named(driver.key, driver.secret, driver.token, None)
    from fsspec.asyn import sync

    async def frozen() -> Any:
        found = await driver.session.get_credentials()
        return await found.get_frozen_credentials()

    keys = sync(driver.loop, frozen)
    until = datetime.datetime.now(datetime.UTC) + _LASTS
    return _named(keys.access_key, keys.secret_key, keys.token, until)


def _named(key: str, secret: str, token: str | None, until: datetime.datetime | None) -> dict[str, Any]:
    return {"access_key_id": key, "secret_access_key": secret, "token": token, "expires_at": until}


def listed(folder: StoragePlace, most: int) -> list[dict[str, Any]]:
    """The entries of a folder, with the field names of its driver.

    Args:
        folder: On storage.
        most: Most entries. More are refused: by S3's listing when it comes to them, by that of another driver, which
            has no pages, when it is complete.

    Raises:
        CaptureError: If there are more, or it cannot be listed.
    """
    # Its driver would collect all pages first. A bucket's versions, and the list of buckets, are left to it.
    if is_s3(folder.address) and folder.path and not folder.storage.version_aware:
        return _by_pages(folder, most) or _alone(folder)
    found: list[dict[str, Any]] = asked(lambda: folder.storage.ls(folder.path, detail=True), folder)
    if len(found) > most:
        raise _too_many(folder, most)
    return found


def _alone(folder: StoragePlace) -> list[dict[str, Any]]:
    """The entry of a place that is no folder with entries: that of a file, none of an empty bucket."""
    entry = info_of(folder)
    return [entry] if entry["type"] == "file" else []


def _by_pages(folder: StoragePlace, most: int) -> list[dict[str, Any]]:
    bucket, key, _ = folder.storage.split_path(folder.path)
    wanted = {"Bucket": bucket, "Prefix": f"{key}/" if key else "", "Delimiter": "/"}
    found: list[dict[str, Any]] = []

    def page() -> tuple[list[dict[str, Any]], str | None]:
        answer = folder.storage.call_s3("list_objects_v2", **wanted)
        inner = [
            {"name": f"{bucket}/{one['Prefix'][:-1]}", "type": "directory", "size": 0}
            for one in answer.get("CommonPrefixes", ())
        ]
        files = [
            {"name": f"{bucket}/{one['Key']}", "type": "file", "size": one["Size"], "ETag": one.get("ETag")}
            for one in answer.get("Contents", ())
        ]
        return inner + files, answer["NextContinuationToken"] if answer.get("IsTruncated") else None

    # A page has an entry at least.
    for _ in range(most + 1):
        entries, following = asked(page, folder)
        found += entries
        if len(found) > most:
            break
        if following is None:
            return found
        wanted["ContinuationToken"] = following
    raise _too_many(folder, most)


def _too_many(folder: StoragePlace, most: int) -> CaptureError:
    return CaptureError(f"{shown(folder.address)}: holds more than {most} files.")


MAX_FILES = 200_000
"""Most files and folders of one capture."""

_MARKS = ("ETag", "etag", "mtime", "LastModified", "last_modified", "modified", "updated", "created")
"""Names in listings of a field by which a change is seen; the best first."""


class FileEntry(NamedTuple):
    """A file as a listing has it."""

    name: str
    """Below the folder, with "/" between its parts."""
    size: int
    """[bytes]"""
    mark: str
    """Another one after a change."""


def remote_digest(address: str) -> str:
    """A digest of a folder or a file by what a listing says of it; no file is read.

    Args:
        address: Of a folder or a file.

    Returns:
        "sha256:<hex>" of names, sizes and ETags, or times of change where there are none; that of a capture does not
        count the file of stripes that may be deleted at any time.

    Raises:
        CaptureError: If there is nothing, storage cannot be read, or its listing is hostile or says neither.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    place = open_place(address)
    entry = info_of(place)
    files = listing(place) if entry.get("type") == "directory" else [file_entry("", entry, place)]
    return "sha256:" + hashlib.sha256(json.dumps(files).encode()).hexdigest()


def listing(place: StoragePlace) -> list[FileEntry]:
    """All files of a folder and of the folders in it, sorted, with names that are safe as paths below a folder.

    Raises:
        CaptureError: If there are none, too many, or two that would be one on some disk.
    """
    files: list[FileEntry] = []
    folders: set[str] = set()
    waiting = deque([("", place)])
    while waiting:
        above, folder = waiting.popleft()
        for name, entry in entries_of(folder):
            below = f"{above}/{name}" if above else name
            if len(below) > 1024:
                raise CaptureError(f"{shown(place.address)}: holds folders within one another that are too deep.")
            if entry["type"] == "directory":
                folders.add(below)
                waiting.append((below, folder.child(name)))
            elif below != CACHE_NAME:
                files.append(file_entry(below, entry, folder.child(name)))
        if len(files) + len(folders) > MAX_FILES:
            raise CaptureError(f"{shown(place.address)}: holds more than {MAX_FILES} files.")
    if not files:
        raise Missing(f"{shown(place.address)}: found no files.")
    # Letters with accents have several spellings, and not every disk tells capitals from small letters.
    names = [unicodedata.normalize("NFC", name).casefold() for name in (*(file.name for file in files), *folders)]
    twice, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise CaptureError(f"{shown(place.address)}: holds two files that differ in spelling alone: {twice!r:.80}.")
    return sorted(files)


def entries_of(folder: StoragePlace) -> list[tuple[str, dict[str, Any]]]:
    """The entries of a folder: names, none of which leads anywhere else, with the fields of the listing.

    Raises:
        CaptureError: If it cannot be listed, or the listing is hostile, or of more than `MAX_FILES`.
    """
    above = folder.path.rstrip("/") + "/"
    entries = []
    for entry in listed(folder, MAX_FILES):
        name, kind = str(entry["name"]), entry["type"]
        if name == folder.path and kind == "file":
            raise CaptureError(f"{shown(folder.address)}: found a file, expected a folder.")
        # Some programs make an empty object to mark a folder.
        if name == above and kind == "file" and entry["size"] == 0:
            continue
        if not name.startswith(above) or not _is_name(name[len(above) :]):
            raise CaptureError(f"{shown(folder.address)}: holds {name!r:.200}, which is no name of a file in it.")
        if kind not in ("file", "directory") or entry.get("islink"):
            raise CaptureError(f"{shown(folder.address)}: {name!r:.200} is a link or a device, expected a file.")
        entries.append((name[len(above) :], entry))
    return entries


def _is_name(name: str) -> bool:
    """Whether a text is one part of a path on every system, and neither leads up nor to a drive."""
    printable = all(ord(letter) >= 32 and ord(letter) != 127 and not 0xD800 <= ord(letter) < 0xE000 for letter in name)
    drive = re.match(r"[A-Za-z]:", name)
    return name not in ("", ".", "..") and printable and not drive and not set(name) & set("/\\")


def file_entry(name: str, entry: dict[str, Any], place: StoragePlace) -> FileEntry:
    size = entry.get("size")
    mark = next((entry[key] for key in _MARKS if entry.get(key) is not None), None)
    if entry.get("type") != "file":
        raise CaptureError(f"{shown(place.address)}: found a folder, expected a file.")
    if not isinstance(size, int) or size < 0 or mark is None:
        raise CaptureError(f"{shown(place.address)}: its storage says no size, or neither ETag nor time of change.")
    return FileEntry(name, size, str(mark.timestamp() if isinstance(mark, datetime.datetime) else mark))


BLOCK_BYTES = 8 * MEGABYTE
"""Bytes of a file that are read at once."""


def fetch_folder(address: str, folder: Path, *, most_bytes: int) -> None:
    """Copy a capture from storage into an empty folder.

    Many files are read at a time, in blocks: at most `WORKERS` · `BLOCK_BYTES` are held in memory, twice that with
    what a driver keeps. Every request is tried five times. The file of found stripes, which fits no copy, is left out.

    Args:
        address: Of the capture's folder.
        folder: An empty folder, or the name of a new one. After an error it may hold some of the files, each whole.
        most_bytes: Largest accepted size of all files together [bytes].

    Raises:
        CaptureError: If there is nothing, the listing is hostile or too large, storage cannot be read or was written
            to meanwhile, or the folder is not empty or cannot be written.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    place = open_place(address)
    files = listing(place)
    _check_size(sum(file.size for file in files), most_bytes, place)
    with reported(f"{shown(folder)}: cannot be written", error=CaptureError):
        make_folder(folder)
        if os.listdir(folder):
            raise CaptureError(f"{shown(folder)}: found files in it, expected an empty folder.")
        for inner in sorted({os.path.dirname(file.name) for file in files}):
            make_folder(folder / inner, own=folder)

    read = reader_of(place)

    def fetch(file: FileEntry) -> None:
        _fetch(read, place.child(file.name), file.size, folder / file.name)

    in_threads(fetch, files)
    if listing(place) != files:
        raise _changed(place)


def fetch_file(address: str, path: Path, *, most_bytes: int) -> None:
    """Copy a file from storage; `path` then holds all of it, or after an error what it held before.

    Args:
        path: Where to; its folder exists.
        most_bytes: Largest accepted size [bytes].

    Raises:
        CaptureError: If there is no such file, it is too large, storage cannot be read or was written to meanwhile,
            or `path` cannot be written.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    place = open_place(address)
    file = file_entry("", info_of(place), place)
    _check_size(file.size, most_bytes, place)
    _fetch(reader_of(place), place, file.size, path)
    if file_entry("", info_of(place), place) != file:
        raise _changed(place)


def read_remote(address: str, limit: int) -> bytes:
    """The content of a small file on storage.

    Args:
        limit: Largest accepted size [bytes].

    Raises:
        CaptureError: If there is no such file, it is too large, or storage cannot be read.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    place = open_place(address)
    size = file_entry("", info_of(place), place).size
    _check_size(size, limit, place)
    return _block(reader_of(place), place, 0, size)


def _fetch(read: Reader, place: StoragePlace, size: int, path: Path) -> None:
    """Copy a file of a known size; it gets its name when it is complete."""

    def write(part: Part) -> None:
        with open(part, "wb") as file:
            for start in range(0, size, BLOCK_BYTES):
                file.write(_block(read, place, start, min(start + BLOCK_BYTES, size)))

    write_atomically(path, write, durable=False, error=CaptureError, links="replace")


def _block(read: Reader, place: StoragePlace, start: int, end: int) -> bytes:
    def block_of() -> bytes:
        block = read(place, start, end)
        if len(block) != end - start:
            raise OSError(f"found {len(block)} bytes, expected {end - start}")
        return block

    return asked(block_of, place)


def _check_size(size: int, most_bytes: int, place: StoragePlace) -> None:
    if size > most_bytes:
        raise CaptureError(f"{shown(place.address)}: takes {size} bytes, expected at most {most_bytes}.")


def _changed(place: StoragePlace) -> CaptureError:
    return CaptureError(f"{shown(place.address)}: changed while it was copied; try again when nobody writes there.")


MAX_FOUND = 20_000
"""Most folders that a pattern may find."""

_WILD = frozenset("*?[")


def find_captures(pattern: str) -> list[str]:
    """Addresses of the captures that a pattern finds.

    Args:
        pattern: Such as "s3://bucket/rooms/*", with `*`, `?` and `[…]` in any part of the path.

    Returns:
        Those of the folders that hold a capture's header, sorted; none where there is nothing.

    Raises:
        CaptureError: If storage cannot be read, its listing is hostile, or more than `MAX_FOUND` folders fit.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    check_address(pattern)
    scheme, rest = pattern.split("://", 1)
    parts = rest.rstrip("/").split("/")
    if any("**" in part for part in parts):
        raise CaptureError(f"{shown(pattern)}: found **, expected one * for each folder on the way.")
    first = next((k for k, part in enumerate(parts) if _WILD & set(part)), len(parts))
    places = [open_place(f"{scheme}://{'/'.join(parts[:first])}")]
    for part in parts[first:]:
        if _WILD & set(part):
            places = [one for found in in_threads(functools.partial(_matching, part=part), places) for one in found]
        else:
            places = [place.child(part) for place in places]
        if len(places) > MAX_FOUND:
            raise CaptureError(f"{shown(pattern)}: finds more than {MAX_FOUND} folders; expected a narrower pattern.")
    headed = in_threads(_has_header, places)
    return sorted(place.address for place, has in zip(places, headed, strict=True) if has)


def _matching(place: StoragePlace, part: str) -> list[StoragePlace]:
    """The folders in a folder whose names fit one part of a pattern."""
    try:
        entries = entries_of(place)
    except Missing:
        return []
    return [place.child(name) for name, e in entries if e["type"] == "directory" and fnmatch.fnmatchcase(name, part)]


def _has_header(place: StoragePlace) -> bool:
    try:
        return info_of(place.child(HEADER_NAME)).get("type") == "file"
    except Missing:
        return False
