"""Shards: `.npy` files of many frames, memory-mapped for reading."""

import contextlib
import math
import mmap
import threading
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.journal import Folder, ImageRef
from jaxscan.files.disk import NPY_DAMAGE, open_regular, read_npy_header


# Each keeps a file open, of which a process may have about a thousand.
_MAPPED = 32


class _Shard(NamedTuple):
    frames: np.ndarray
    file: mmap.mmap
    start: int
    """Offset of the first frame in the file [bytes]."""


class Shards:
    """The shards of one capture: checked when it is opened, mapped while they are read."""

    def __init__(self, folder: Path, shape: tuple[int, ...]) -> None:
        """`shape` is the shape of one frame."""
        self._path, self._folder, self._shape = folder, Folder(folder), shape
        self._length: dict[str, int] = {}
        self._mapped: OrderedDict[str, _Shard] = OrderedDict()
        self._lock = threading.Lock()

    def check(self, reference: ImageRef, located: Path) -> None:
        """Check that a shard has frames of the right size and is long enough."""
        if reference.path not in self._length:
            self._length[reference.path] = len(_open_shard(located, name=reference.path, shape=self._shape).frames)
        self._reaches(reference, self._length[reference.path])

    def image(self, reference: ImageRef) -> np.ndarray:
        """One frame, uint8 [rows, columns(, 3)]: a read-only view of the file."""
        frames = self._open(reference.path).frames
        self._reaches(reference, len(frames))
        return frames[reference.index]

    def run(self, references: Sequence[ImageRef]) -> np.ndarray | None:
        """Frames that lie one after another in one shard, uint8 [frames, rows, columns(, 3)]; else None.

        Nothing is copied: the result is a read-only view of the file, and is being read ahead.
        """
        first, last = references[0], references[-1]
        if first.index is None or last.index != first.index + len(references) - 1:
            return None
        if any(one.path != first.path or one.index != k for k, one in enumerate(references, first.index)):
            return None
        shard = self._open(first.path)
        self._reaches(last, len(shard.frames))
        frames = shard.frames[first.index : first.index + len(references)]
        if not frames.flags.c_contiguous:
            return None
        _read_ahead(shard.file, shard.start + first.index * frames[0].nbytes, frames.nbytes)
        return frames

    def _reaches(self, reference: ImageRef, length: int) -> None:
        if reference.index is None or reference.index >= length:
            raise CaptureError(f"{reference}: the shard has only {length} images.")

    def _open(self, path: str) -> _Shard:
        with self._lock:
            shard = self._mapped.pop(path, None)
            if shard is None:
                name = str(self._path / path)
                try:
                    located = self._folder.locate(ImageRef(path))
                except CaptureError as problem:
                    raise CaptureError(f"{self._path}/{problem}") from problem
                shard = _open_shard(located, name=name, shape=self._shape)
            # A shard that is dropped here stays mapped as long as a view of it is in use.
            self._mapped[path] = shard
            while len(self._mapped) > _MAPPED:
                self._mapped.popitem(last=False)
            return shard


def _open_shard(path: Path, *, name: str, shape: tuple[int, ...]) -> _Shard:
    """A shard, memory-mapped."""
    try:
        with open_regular(path, error=CaptureError, links="refuse") as file:
            found, column_major, dtype = read_npy_header(file)
            start = file.tell()
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if dtype != np.uint8 or found[1:] != shape or len(found) != 1 + len(shape):
            expected = " x ".join(map(str, shape))
            raise CaptureError(f"{name}: found {dtype} with shape {found}, expected uint8 with shape (n, {expected}).")
        count = math.prod(found)
        _check_length(mapped, start, count, math.prod(shape), name)
        # `frombuffer` refuses an empty buffer.
        frames = np.frombuffer(mapped, np.uint8, count, start) if count else np.empty(0, np.uint8)
        return _Shard(frames.reshape(found, order="F" if column_major else "C"), mapped, start)
    except NPY_DAMAGE as problem:
        raise CaptureError(f"{name}: not a readable .npy file: {problem}.") from problem


def _check_length(mapped: mmap.mmap, start: int, count: int, frame: int, name: str) -> None:
    """Check that a shard has the length that its header announces: a byte too many moves all images behind it."""
    surplus = len(mapped) - start - count
    # A program that is stopped while it shortens a shard, between header and file, leaves room for whole frames.
    room = surplus >= 0 and surplus % frame == 0 and not np.frombuffer(mapped, np.uint8, offset=start + count).any()
    if surplus != 0 and not room:
        found, expected = len(mapped), start + count
        raise CaptureError(f"{name}: not a readable .npy file: found {found} bytes, its header announces {expected}.")


def _read_ahead(file: mmap.mmap, begin: int, size: int) -> None:
    """Advise the system to read a part of a file ahead, where it takes such advice."""
    if hasattr(mmap, "MADV_WILLNEED"):
        page = begin // mmap.PAGESIZE * mmap.PAGESIZE
        with contextlib.suppress(OSError, ValueError):
            file.madvise(mmap.MADV_WILLNEED, page, begin + size - page)
