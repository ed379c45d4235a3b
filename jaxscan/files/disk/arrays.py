"""NPZ files of plain arrays; reading is safe: a hostile file can neither run code nor fill the memory."""

import io
import lzma
import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.reading import Links, open_regular
from jaxscan.files.disk.writing import Part


MAX_ARRAYS_BYTES = 1 << 34
"""Most memory that the arrays of one file may take together [bytes]."""
MAX_EXPANSION = 20
"""Largest accepted ratio of all arrays together to the size of the file; deflate reaches 1000."""
MAX_DIRECTORY_BYTES = 1 << 22
"""Largest list of an archive's members that is read; parsed, it takes twenty times as much memory."""

_SMALL = 1 << 20
_MAX_AXIS = 1 << 31
_KINDS = "biufcSU"
_BLOCK = MAX_DIRECTORY_BYTES

# Errors of NumPy's reader for damaged headers, which are Python literals.
NPY_DAMAGE = (OSError, ValueError, EOFError, SyntaxError, tokenize.TokenError, OverflowError, TypeError, RecursionError)
# Errors of the reader of archives; `RuntimeError` where a member is encrypted.
_ZIP_DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, struct.error)


def write_arrays(path: Part, arrays: Mapping[str, np.ndarray]) -> None:
    """Write an NPZ file, not compressed."""
    with open(path, "wb") as file:
        np.savez(file, allow_pickle=False, **dict(arrays))


def read_arrays(
    path: str | Path,
    *,
    error: type[JaxscanError],
    limit: int = MAX_ARRAYS_BYTES,
    only: str | None = None,
    stored: bool = False,
    links: Links = "follow",
) -> dict[str, np.ndarray]:
    """All arrays of an NPZ file, by name.

    Args:
        limit: Most memory that the arrays may take together [bytes]; they also take at most `MAX_EXPANSION` times
            the size of the file, and a MiB.
        only: Read only the array of this name.
        stored: Refuse compressed arrays, so that they take no more memory than the size of the file.
        links: As in `open_regular`.

    Raises:
        JaxscanError: Of type `error`, if the file is missing, damaged, not an NPZ file, too large, holds a name twice
            or Python objects.
    """
    with open_regular(path, error=error, links=links) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            with zipfile.ZipFile(cast(BinaryIO, _InBlocks(file))) as archive:
                members = _members(archive.infolist(), stored=stored)
                wanted = {name: member for name, member in members.items() if only in (None, name)}
                total = sum(member.file_size for member in wanted.values())
                # Members may lie over one another in the file, so each may be as large as the file.
                most = size if stored else MAX_EXPANSION * size + _SMALL
                if total > min(limit, most):
                    raise ValueError(
                        f"its arrays would take {total} bytes of memory, expected at most {min(limit, most)}"
                    )
                return {name: _read_member(archive, member) for name, member in wanted.items()}
        except MemoryError as problem:
            raise error(f"{path}: its arrays do not fit into the memory that is free.") from problem
        except (*NPY_DAMAGE, *_ZIP_DAMAGE) as problem:
            reason = str(getattr(problem, "strerror", None) or problem)
            raise error(f"{path}: not a readable .npz file: {reason:.200}.") from problem


def _members(listed: list[zipfile.ZipInfo], *, stored: bool) -> dict[str, zipfile.ZipInfo]:
    """The members of an archive by the names of their arrays."""
    members = {member.filename.removesuffix(".npy"): member for member in listed}
    # If two arrays had one name, programs would take one or the other.
    if len(members) < len(listed):
        raise ValueError(f"found {len(listed)} arrays of {len(members)} names, expected each name once")
    if stored and any(member.compress_type != zipfile.ZIP_STORED for member in listed):
        raise ValueError("found compressed arrays, expected plain ones")
    return members


class _InBlocks:
    """A file that is read in blocks: `zipfile` reads an archive's list of members at once, however long it is."""

    def __init__(self, file: io.BufferedReader) -> None:
        self.seek, self.tell, self.seekable, self.close = file.seek, file.tell, file.seekable, file.close
        self._read = file.read

    def read(self, size: int = -1) -> bytes:
        if size > MAX_DIRECTORY_BYTES:
            raise ValueError(f"its list of arrays takes {size} bytes, expected at most {MAX_DIRECTORY_BYTES}")
        return self._read(size)


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(member) as opened:
        stream = cast(io.BufferedIOBase, opened)
        shape, column_major, dtype = read_npy_header(stream)
        # The size in the archive is checked before memory is allocated; beside an axis of length 0 any other fits.
        if math.prod(shape) * dtype.itemsize > member.file_size or max(shape, default=0) > _MAX_AXIS:
            raise ValueError(f"{member.filename:.60} announces {dtype} with shape {shape}, which it cannot hold")
        array = np.empty(shape, dtype, order="F" if column_major else "C")
        # Read to the end, where the archive compares its checksum.
        if _fill(stream, array) < array.nbytes or stream.read(1):
            raise ValueError(f"{member.filename:.60} does not hold {dtype} with shape {shape} and nothing else")
    return array


def check_arrays(
    arrays: Mapping[str, np.ndarray],
    expected: Mapping[str, tuple[type[np.generic], tuple[str | int, ...]]],
    sizes: Mapping[str, int],
    *,
    name: str,
    error: type[JaxscanError],
) -> dict[str, int]:
    """Check types and shapes of arrays, and that floats (float32 or float64) are finite.

    Args:
        arrays: By key.
        expected: Type and axes of each array; an axis is a size, or a name that stands for the same size everywhere.
        sizes: Sizes of axes that are known beforehand, by name.

    Returns:
        The size of every named axis.

    Raises:
        JaxscanError: Of type `error`, with the array that is missing or wrong.
    """
    sizes = dict(sizes)
    for key, (kind, axes) in expected.items():
        array = arrays.get(key)
        if array is None:
            raise error(f"{name}: {key} is missing.")
        for axis, size in zip(axes, array.shape, strict=False):
            if isinstance(axis, str):
                sizes.setdefault(axis, size)
        shape = tuple(sizes.get(axis, axis) if isinstance(axis, str) else axis for axis in axes)
        single_or_double = array.dtype in (np.dtype(np.float32), np.dtype(np.float64))
        fits = single_or_double if kind is np.floating else np.issubdtype(array.dtype, kind)
        if array.shape != shape or not fits:
            raise error(
                f"{name}: {key}: found {array.dtype} with shape {array.shape}, "
                f"expected {kind.__name__} with shape {shape}."
            )
        if kind is np.floating and not np.isfinite(array).all():
            raise error(f"{name}: {key} is not finite everywhere.")
    return sizes


def read_npy_header(stream: io.BufferedIOBase) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether the order is column-major, and type of the array that follows: numbers or text.

    Raises:
        ValueError: Or another error of `NPY_DAMAGE`, if no such array follows.
    """
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"its version {version} is unknown")
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, column_major, dtype = read_header(stream)
    # A type without a size, such as text of no letters, would allow any shape.
    if dtype.kind not in _KINDS or dtype.itemsize == 0 or min(shape, default=0) < 0:
        raise ValueError(f"it announces {dtype} with shape {shape}")
    return shape, column_major, dtype


def _fill(stream: io.BufferedIOBase, array: np.ndarray) -> int:
    """Read bytes into the memory of an array; returns the number of bytes read."""
    if array.nbytes == 0:
        return 0
    target = array.reshape(-1, order="A").view(np.uint8).data
    done = 0
    while done < len(target) and (count := stream.readinto(target[done : done + _BLOCK])):
        done += count
    return done
