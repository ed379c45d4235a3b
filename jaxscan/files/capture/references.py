"""References from a journal to images: relative paths that stay inside the capture's folder."""

import math
import os
import re
import stat
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxscan.errors import CaptureError


MAX_IMAGES = 16
"""Images that one frame of a record may list: exposures of a bracket, and repetitions to average."""


@dataclass(frozen=True, slots=True)
class ImageRef:
    """An image file, or one image of a shard (an `.npy` file of uint8 [n, rows, columns(, 3)])."""

    path: str
    """Relative to the folder of the capture, with "/" between its parts."""
    index: int | None = None
    """Which image of a shard; None for an image file."""
    exposure_s: float | None = None
    """Exposure [s]; None where the record names one image without it."""
    sha256: str | None = None
    """Digest of the file, or of the frame in a shard, in hexadecimal digits; None where the record has none."""

    def __str__(self) -> str:
        return self.path if self.index is None else f"{self.path}#{self.index}"


# Parts of letters and digits, none of which begins with a dot; an image of a shard has its number.
_PLAIN = re.compile(r"(?:[\w-][\w.-]*/)*[\w-][\w.-]*(?:\.npy#[0-9]{1,9}|(?<!\.npy))", re.ASCII)


def is_plain(reference: str) -> bool:
    """Whether a reference is written in the usual letters, so that `parse_reference` accepts it."""
    return len(reference) <= 1024 and _PLAIN.fullmatch(reference) is not None


def parse_images(value: Any) -> tuple[ImageRef, ...]:
    """The images of one frame as they stand in a record: none, one, or a list with exposures.

    Raises:
        ValueError: If it is of another kind, is too long, or could lead out of the folder.
    """
    if value is None:
        return ()
    if not isinstance(value, list):
        return (parse_reference(value),)
    if not 1 <= len(value) <= MAX_IMAGES:
        raise ValueError(f"found a list of {len(value)} images, expected 1 to {MAX_IMAGES}")
    return tuple(_exposed(one) for one in value)


def _exposed(value: Any) -> ImageRef:
    if not isinstance(value, dict) or not {"file", "exposure_s"} <= value.keys():
        raise ValueError(f'found {value!r:.60} in a list, expected {{"file": ..., "exposure_s": ...}}')
    exposure = value["exposure_s"]
    # A bool counts as an integer in Python, and an integer may be too large for a float.
    number = isinstance(exposure, int | float) and not isinstance(exposure, bool)
    if not number or not 0 < exposure <= 1e6 or not math.isfinite(1.0 / exposure):
        raise ValueError(f"exposure_s: found {exposure!r:.60}, expected a number of seconds above 0")
    return replace(parse_reference(value["file"]), exposure_s=float(exposure))


def with_digests(images: tuple[ImageRef, ...], given: Any) -> tuple[ImageRef, ...]:
    """Images with the digests of their record: one text, or a list of them in the order of the images.

    Anything else that stands there is kept as a text, which fits no image.
    """
    if given is None:
        return images
    if len(images) == 1 and isinstance(given, str):
        return (ImageRef(images[0].path, images[0].index, images[0].exposure_s, given),)
    listed = given if isinstance(given, list) else [given]
    texts = [one if isinstance(one, str) else repr(one)[:64] for one in listed[: len(images)]]
    texts += ["none"] * (len(images) - len(texts))
    return tuple(ImageRef(one.path, one.index, one.exposure_s, text) for one, text in zip(images, texts, strict=True))


def parse_reference(value: Any) -> ImageRef:
    """The reference to one image.

    Raises:
        ValueError: If it is none, or could lead out of the folder.
    """
    if not isinstance(value, str):
        raise ValueError(f"found {value!r:.60}, expected a path, null, or a list of images with exposures")
    if is_plain(value):
        path, _, number = value.partition("#")
        return ImageRef(path, int(number) if number else None)
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
    """Finds referenced files in the folder of a capture, and refuses all files outside it."""

    def __init__(self, root: Path) -> None:
        self._root = Path(os.path.realpath(root))
        self._inside: dict[str, bool] = {}
        self._files: dict[str, frozenset[str]] = {}

    def holds(self, path: str) -> bool:
        """Whether a path is that of a regular file inside; links, and names in other spellings, are for `locate`.

        Each folder is listed once, which is faster than looking at thousands of images one by one.
        """
        folder, _, name = path.rpartition("/")
        if folder not in self._files:
            self._files[folder] = self._list(self._root / folder)
        return name in self._files[folder]

    def _list(self, folder: Path) -> frozenset[str]:
        if not self._is_inside(folder):
            return frozenset()
        try:
            with os.scandir(folder) as entries:
                return frozenset(entry.name for entry in entries if entry.is_file(follow_symlinks=False))
        except OSError:
            return frozenset()

    def locate(self, reference: ImageRef) -> Path:
        """Path of an existing regular file, where a link inside leads to the file itself.

        Raises:
            CaptureError: If it does not exist, is no regular file, or a link leads out.
        """
        path = self._root / reference.path
        try:
            status = os.lstat(path)
            inside = self._is_inside(path.parent)
            if stat.S_ISLNK(status.st_mode):
                path = Path(os.path.realpath(path))
                inside, status = inside and self._is_inside(path), os.stat(path)
        except (OSError, ValueError) as problem:
            reason = "no such file" if isinstance(problem, FileNotFoundError) else getattr(problem, "strerror", problem)
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
