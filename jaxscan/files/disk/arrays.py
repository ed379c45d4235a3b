"""NPZ files of plain arrays; reading is safe: a hostile file can neither run code nor fill the memory."""

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
"""Largest accepted array; the bytes that are really read are bounded by the size of the file."""
MAX_EXPANSION = 200
"""Largest accepted ratio of an array to its compressed form; deflate reaches 1000."""

_BLOCK = 1 << 22

# Errors of NumPy's reader for damaged headers, which are Python literals.
NPY_DAMAGE = (OSError, ValueError, EOFError, SyntaxError, tokenize.TokenError, OverflowError, TypeError, RecursionError)
# Errors of the reader of archives; `RuntimeError` where a member is encrypted.
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
        only: Read only the array of this name.

    Raises:
        JaxscanError: Of type `error`, if the file is missing, damaged, not an NPZ file, or holds Python objects.
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
        # The size in the archive is checked before memory is allocated.
        if math.prod(shape) * dtype.itemsize > member.file_size:
            raise ValueError(f"{member.filename} announces {dtype} with shape {shape}, which it cannot hold")
        array = np.empty(shape, dtype, order="F" if column_major else "C")
        # Read to the end, where the archive compares its checksum.
        if _fill(stream, array) < array.nbytes or stream.read(1):
            raise ValueError(f"{member.filename} does not hold {dtype} with shape {shape} and nothing else")
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
        name: Name of the file, for messages.
        error: Type of the error raised.

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
    """Shape, whether the order is column-major, and type of the array that follows; Python objects are refused.

    Raises:
        ValueError: Or another error of `NPY_DAMAGE`, if no such array follows.
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
    """Read bytes into the memory of an array; returns the number of bytes read."""
    if array.nbytes == 0:
        return 0
    target = array.reshape(-1, order="A").view(np.uint8).data
    done = 0
    while done < len(target) and (count := stream.readinto(target[done : done + _BLOCK])):
        done += count
    return done
