"""NPZ files of plain arrays, read so that a hostile file can neither run code nor fill memory."""

import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxscan.errors import JaxscanError


MAX_ARRAY_BYTES = 1 << 36
"""Largest accepted array; what is really read is bounded by the size of the file."""
MAX_EXPANSION = 200
"""Largest accepted ratio of an array to its compressed form; deflate reaches 1000."""

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
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{member.filename} has the unknown version {version}")
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, column_major, dtype = read_header(stream)
        # The archive says how many bytes there are; only then is memory taken for them.
        if dtype.hasobject or math.prod(shape) * dtype.itemsize > member.file_size or min(shape, default=0) < 0:
            raise ValueError(f"{member.filename} announces {dtype} with shape {shape}, which it cannot hold")
        data = stream.read(math.prod(shape) * dtype.itemsize)
    array = np.frombuffer(data, dtype, count=math.prod(shape)) if math.prod(shape) else np.zeros(0, dtype)
    return array.reshape(shape, order="F" if column_major else "C").copy()
