"""NPZ files of plain arrays, read so that a hostile file can neither run code nor fill memory."""

import io
import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np

from jaxscan.errors import JaxscanError


MAX_ARRAY_BYTES = 1 << 36
"""Largest accepted array; what is really read is bounded by the size of the file."""
MAX_EXPANSION = 200
"""Largest accepted ratio of an array to its compressed form; deflate reaches 1000."""

_BLOCK = 1 << 22

# What NumPy's reader raises on damaged headers, which are Python literals.
NPY_DAMAGE = (OSError, ValueError, EOFError, SyntaxError, tokenize.TokenError, OverflowError, TypeError, RecursionError)
# And what the archive's reader raises; `RuntimeError` where a member is encrypted.
_ZIP_DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, struct.error)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write an NPZ file, not compressed."""
    with open(path, "wb") as file:
        np.savez(file, allow_pickle=False, **dict(arrays))


def read_arrays(
    path: str | Path, *, error: type[JaxscanError], limit: int = MAX_ARRAY_BYTES, only: str | None = None
) -> dict[str, np.ndarray]:
    """All arrays of an NPZ file, by name.

    Args:
        path: The file.
        error: Type of the error raised.
        limit: Largest accepted array [bytes].
        only: Read no other than the array of this name.

    Raises:
        JaxscanError: Of type `error`, if it is missing, damaged, no NPZ file, or holds Python
            objects.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
            return {
                name: _read_member(archive, member, limit) for name, member in members.items() if only in (None, name)
            }
    except FileNotFoundError as problem:
        raise error(f"{path}: no such file.") from problem
    except (*NPY_DAMAGE, *_ZIP_DAMAGE) as problem:
        raise error(f"{path}: not a readable .npz file: {getattr(problem, 'strerror', None) or problem}.") from problem


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, limit: int) -> np.ndarray:
    if member.file_size > limit or member.file_size > MAX_EXPANSION * member.compress_size + 1024:
        raise ValueError(f"{member.filename} would take {member.file_size} bytes of memory")
    with archive.open(member) as opened:
        stream = cast(io.BufferedIOBase, opened)
        shape, column_major, dtype = read_npy_header(stream)
        # The archive says how many bytes there are; only then is memory taken for them.
        if math.prod(shape) * dtype.itemsize > member.file_size:
            raise ValueError(f"{member.filename} announces {dtype} with shape {shape}, which it cannot hold")
        array = np.empty(shape, dtype, order="F" if column_major else "C")
        # To the end, where the archive compares its checksum.
        if _fill(stream, array) < array.nbytes or stream.read(1):
            raise ValueError(f"{member.filename} does not hold {dtype} with shape {shape} and nothing else")
    return array


def read_npy_header(stream: io.BufferedIOBase) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether columns come first, and type of the array that follows; it holds no Python objects.

    Raises:
        ValueError: Or another of `NPY_DAMAGE`, if there is no such array.
    """
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"its version {version} is unknown")
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, column_major, dtype = read_header(stream)
    if dtype.hasobject or min(shape, default=0) < 0:
        raise ValueError(f"it announces {dtype} with shape {shape}")
    return shape, column_major, dtype


def _fill(stream: io.BufferedIOBase, array: np.ndarray) -> int:
    """Read the bytes of an array into its memory; how many came."""
    if array.nbytes == 0:
        return 0
    target = array.reshape(-1, order="A").view(np.uint8).data
    done = 0
    while done < len(target) and (count := stream.readinto(target[done : done + _BLOCK])):
        done += count
    return done
