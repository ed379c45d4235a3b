"""Listings of storage, checked: names are paths below a folder on every system, and there are not too many."""

import datetime
import hashlib
import json
import re
import unicodedata
from collections import Counter, deque
from typing import Any, NamedTuple

from jaxscan.errors import CaptureError
from jaxscan.files.capture import CACHE_NAME
from jaxscan.files.disk import shown
from jaxscan.files.remote.pages import listed
from jaxscan.files.remote.place import Missing, Place, info_of, open_place


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


def listing(place: Place) -> list[FileEntry]:
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


def entries_of(folder: Place) -> list[tuple[str, dict[str, Any]]]:
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


def file_entry(name: str, entry: dict[str, Any], place: Place) -> FileEntry:
    size = entry.get("size")
    mark = next((entry[key] for key in _MARKS if entry.get(key) is not None), None)
    if entry.get("type") != "file":
        raise CaptureError(f"{shown(place.address)}: found a folder, expected a file.")
    if not isinstance(size, int) or size < 0 or mark is None:
        raise CaptureError(f"{shown(place.address)}: its storage says no size, or neither ETag nor time of change.")
    return FileEntry(name, size, str(mark.timestamp() if isinstance(mark, datetime.datetime) else mark))
