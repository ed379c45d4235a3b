"""Storage of images in a capture: a file each, packed by zstd or as PNG, or raw frames in shards."""

import hashlib
import io
import os
import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.disk import append_whole, open_to_write, reported, sync_to_disk, write_atomically


Storage = Literal["zstd", "png", "npy"]
STORAGES: tuple[Storage, ...] = get_args(Storage)

SHARD_BYTES = 64 << 20
SHARD_RECORDS = 32
# NumPy's own header of a few frames has this length, whatever their number.
_HEADER_BYTES = 128


@dataclass(frozen=True)
class WriteSettings:
    """How a capture is written; `create_capture` describes each."""

    storage: Storage = "zstd"
    durable: bool = True
    digests: bool = False


class FileStore:
    """One file per image, named after the record.

    As in `ShardStore`, one thread calls `names` and `take`, and many call `write`.
    """

    def __init__(self, path: Path, settings: WriteSettings) -> None:
        self._path, self._settings = path, settings
        self._suffix = ".png" if settings.storage == "png" else ".zst"

    def names(self, side: str, stem: str, count: int) -> list[str]:
        stems = [stem] if count == 1 else [f"{stem}_{k}" for k in range(count)]
        return [f"{side}/{one}{self._suffix}" for one in stems]

    def take(self, side: str, count: int) -> None:
        pass

    def write(self, name: str, image: np.ndarray) -> str:
        # Here, so that reading a capture's header does not load OpenCV.
        from jaxscan.vision import encode_png, encode_zstd

        data = encode_png(image) if self._suffix == ".png" else encode_zstd(image)
        durable = self._settings.durable
        write_atomically(self._path / name, data, durable=durable, error=CaptureError, links="replace")
        return hashlib.sha256(data).hexdigest() if self._settings.digests else ""

    def close(self) -> None:
        pass


class _Place(NamedTuple):
    shard: int
    used: int
    length: int


class ShardStore:
    """Shards `on/000000.npy`, `off/000000.npy`, ... of raw frames, in the order in which they are appended.

    A shard has its full length from the beginning, and images are written into it one by one; so
    it is readable at any moment, and every frame that the journal names in it is complete. Shards
    of an earlier session are never changed.
    """

    def __init__(self, path: Path, shape: tuple[int, ...], durable: bool, digests: bool) -> None:
        self._path, self._shape, self._durable, self._digests = path, shape, durable, digests
        self._bytes = int(np.prod(shape, dtype=np.int64))
        self._place = {side: _Place(_last_shard(path / side), 0, 0) for side in ("on", "off")}
        self._length: dict[str, int] = {}
        self._made: set[str] = set()
        self._lock = threading.Lock()

    def names(self, side: str, stem: str, count: int) -> list[str]:
        """References for `count` images of one frame; `side` is "on" or "off". Changes nothing."""
        place = self._room(side, count)
        return [f"{_shard_name(side, place.shard)}#{place.used + k}" for k in range(count)]

    def take(self, side: str, count: int) -> None:
        """Reserve those names."""
        place = self._room(side, count)
        self._place[side] = place._replace(used=place.used + count)
        self._length[_shard_name(side, place.shard)] = place.length

    def _room(self, side: str, count: int) -> _Place:
        """Start a frame: all its images go into one shard, so that chunks of frames can be mapped."""
        place = self._place[side]
        if place.used + count <= place.length:
            return place
        frames = min(SHARD_RECORDS, max(1, SHARD_BYTES // (count * self._bytes)))
        # A power of two, so that chunks of another power of two never need parts of two shards.
        return _Place(place.shard + 1, 0, count * (1 << (frames.bit_length() - 1)))

    def write(self, name: str, image: np.ndarray) -> str:
        """Write an image under its name; after this the journal may name it.

        Returns:
            The sha256 of the image as it is stored, in hexadecimal digits; "" without `digests`.
        """
        shard, _, index = name.partition("#")
        with reported(f"{self._path / shard}: cannot be written", error=CaptureError):
            with self._lock:
                self._make(shard)
            with open_to_write(self._path / shard, "change") as file:
                file.seek(_HEADER_BYTES + int(index) * self._bytes)
                data = np.ascontiguousarray(image).reshape(-1).data
                digest = hashlib.sha256(data).hexdigest() if self._digests else ""
                while data:
                    data = data[file.write(data) :]
                if self._durable:
                    os.fsync(file.fileno())
        return digest

    def _make(self, shard: str) -> None:
        if shard in self._made:
            return
        file = self._path / shard
        with open_to_write(file, "make") as made:
            append_whole(made, _header(self._length[shard], self._shape), durable=False)
            made.truncate(_HEADER_BYTES + self._length[shard] * self._bytes)
        if self._durable:
            sync_to_disk(file)
            sync_to_disk(file.parent)
        self._made.add(shard)

    def close(self) -> None:
        """Shorten the last shards to their frames, after all calls of `write` have returned."""
        for side, place in self._place.items():
            shard = _shard_name(side, place.shard)
            if shard not in self._made or place.used >= place.length:
                continue
            file_path = self._path / shard
            with (
                reported(f"{file_path}: cannot be written", error=CaptureError),
                open_to_write(file_path, "change") as file,
            ):
                # The header shrinks before the file, so the file is readable at any moment. The disk writes over a
                # few bytes in one go.
                file.write(_header(place.used, self._shape))
                if self._durable:
                    os.fsync(file.fileno())
                file.truncate(_HEADER_BYTES + place.used * self._bytes)


def image_store(path: Path, shape: tuple[int, ...], settings: WriteSettings) -> FileStore | ShardStore:
    """The store for images of `shape` in the capture at `path`.

    With `digests`, `write` returns the sha256 of the file, or of the frame in a shard.
    """
    if settings.storage not in STORAGES:
        raise ValueError(f"Unknown storage {settings.storage!r}; known: {', '.join(STORAGES)}.")
    if settings.storage == "npy":
        return ShardStore(path, shape, settings.durable, settings.digests)
    return FileStore(path, settings)


def _shard_name(side: str, number: int) -> str:
    return f"{side}/{number:06d}.npy"


def _last_shard(folder: Path) -> int:
    """The largest number of a shard; -1 if there is none."""
    names = os.listdir(folder) if os.path.isdir(folder) else []
    found = (re.fullmatch(r"([0-9]{6,9})\.npy", name) for name in names)
    return max((int(match[1]) for match in found if match), default=-1)


def _header(length: int, shape: Sequence[int]) -> bytes:
    """The beginning of an `.npy` file of uint8 [length, *shape], of the same size for every length."""
    text = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        text, {"descr": "|u1", "fortran_order": False, "shape": (length, *map(int, shape))}
    )
    found = text.getvalue()
    if len(found) != _HEADER_BYTES:
        raise CaptureError(f"NumPy's header has {len(found)} bytes, expected {_HEADER_BYTES}.")
    return found
