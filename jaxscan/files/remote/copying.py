"""Copies from storage: whole, or not there."""

import os
from pathlib import Path

from jaxscan.errors import CaptureError
from jaxscan.files.disk import MEGABYTE, Part, make_folder, reported, shown, write_atomically
from jaxscan.files.remote.listing import FileEntry, file_entry, listing
from jaxscan.files.remote.place import Place, asked, in_threads, info_of, open_place
from jaxscan.files.remote.reading import Reader, reader_of


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
        address: Of the file.
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
        address: Of the file.
        limit: Largest accepted size [bytes].

    Raises:
        CaptureError: If there is no such file, it is too large, or storage cannot be read.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    place = open_place(address)
    size = file_entry("", info_of(place), place).size
    _check_size(size, limit, place)
    return _block(reader_of(place), place, 0, size)


def _fetch(read: Reader, place: Place, size: int, path: Path) -> None:
    """Copy a file of a known size; it gets its name when it is complete."""

    def write(part: Part) -> None:
        with open(part, "wb") as file:
            for start in range(0, size, BLOCK_BYTES):
                file.write(_block(read, place, start, min(start + BLOCK_BYTES, size)))

    write_atomically(path, write, durable=False, error=CaptureError, links="replace")


def _block(read: Reader, place: Place, start: int, end: int) -> bytes:
    def block_of() -> bytes:
        block = read(place, start, end)
        if len(block) != end - start:
            raise OSError(f"found {len(block)} bytes, expected {end - start}")
        return block

    return asked(block_of, place)


def _check_size(size: int, most_bytes: int, place: Place) -> None:
    if size > most_bytes:
        raise CaptureError(f"{shown(place.address)}: takes {size} bytes, expected at most {most_bytes}.")


def _changed(place: Place) -> CaptureError:
    return CaptureError(f"{shown(place.address)}: changed while it was copied; try again when nobody writes there.")
