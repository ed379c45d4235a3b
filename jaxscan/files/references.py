"""References from a journal to images: relative paths that stay inside the capture's folder."""

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.arrays import NPY_DAMAGE


@dataclass(frozen=True)
class ImageRef:
    """An image file, or one image of a shard (an `.npy` file of uint8 [n, rows, columns(, 3)])."""

    path: str
    """Relative to the folder of the capture, with "/" between its parts."""
    index: int | None = None
    """Which image of a shard; None for an image file."""

    def __str__(self) -> str:
        return self.path if self.index is None else f"{self.path}#{self.index}"


def parse_reference(value: Any) -> ImageRef | None:
    """An image reference as it stands in a record.

    Raises:
        ValueError: If it is none, is not supported, or could lead out of the folder.
    """
    if value is None:
        return None
    if isinstance(value, list):
        raise ValueError(
            "found a list of exposures; brackets and averaging are reserved and not supported yet: name one image"
        )
    if not isinstance(value, str):
        raise ValueError(f"found {value!r:.60}, expected a path, or null")
    path, index = value, None
    if match := re.fullmatch(r"(.*\.npy)#([0-9]{1,9})", value, re.DOTALL):
        path, index = match[1], int(match[2])
    elif value.endswith(".npy"):
        raise ValueError(f'found "{value:.60}", expected "{value:.60}#<index>": which image of the shard is meant')
    if problem := _unsafe(path):
        raise ValueError(f"found {value!r:.60}, {problem}; expected a relative path inside the capture's folder")
    return ImageRef(path, index)


def _unsafe(path: str) -> str | None:
    if not path or len(path) > 1024:
        return "which is empty or too long"
    if any(ord(character) < 32 or ord(character) == 127 for character in path):
        return "which has control characters"
    if "\\" in path:
        return 'which has a backslash (the separator is "/" everywhere)'
    if path.startswith("/") or re.match(r"[A-Za-z]:", path):
        return "which is not relative"
    if any(part in ("", ".", "..") for part in path.split("/")):
        return 'which has an empty part, "." or ".."'
    return None


class Folder:
    """The folder of a capture as references see it: nothing outside it exists."""

    def __init__(self, root: Path) -> None:
        self._root = Path(os.path.realpath(root))
        self._inside: dict[str, bool] = {}

    def locate(self, reference: ImageRef) -> Path:
        """Path of an existing regular file.

        Raises:
            CaptureError: If it does not exist, is no regular file, or a link leads out.
        """
        path = self._root / reference.path
        try:
            status = os.lstat(path)
            inside = self._is_inside(path.parent)
            if stat.S_ISLNK(status.st_mode):
                inside, status = inside and self._is_inside(path), os.stat(path)
        except (OSError, ValueError) as problem:
            reason = "no such file" if isinstance(problem, FileNotFoundError) else str(problem)
            raise CaptureError(f"{reference.path}: {reason}.") from problem
        if not inside:
            raise CaptureError(f"{reference.path}: a link that leads out of the capture's folder; copy the file there.")
        if not stat.S_ISREG(status.st_mode):
            raise CaptureError(f"{reference.path}: found a folder, device or pipe, expected an image file.")
        return path

    def _is_inside(self, path: Path) -> bool:
        # Thousands of images share a few folders, and resolving is slow.
        key = str(path)
        if key not in self._inside:
            self._inside[key] = Path(os.path.realpath(path)).is_relative_to(self._root)
        return self._inside[key]


def open_shard(path: Path, *, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """A shard, memory-mapped: uint8 [n, *shape].

    Raises:
        CaptureError: If it is damaged, or its images are of another size or type.
    """
    try:
        # Not np.load, which would also open archives and pickles.
        shard = np.lib.format.open_memmap(path, mode="r")
    except NPY_DAMAGE as problem:
        raise CaptureError(f"{name}: not a readable .npy file: {problem}.") from problem
    if shard.dtype != np.uint8 or shard.shape[1:] != shape or shard.ndim != 1 + len(shape):
        expected = " x ".join(map(str, shape))
        raise CaptureError(
            f"{name}: found {shard.dtype} with shape {shard.shape}, expected uint8 with shape (n, {expected})."
        )
    return shard
