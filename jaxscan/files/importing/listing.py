"""The images in a stranger's folder: regular files only, no links, and names that match patterns."""

import fnmatch
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.disk import shown


MOST_FILES = 200_000
MOST_FOLDERS = 10_000
DEEPEST = 8
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
VIDEOS = (".avi", ".mp4", ".mov", ".m4v", ".mkv", ".webm")
_LONGEST_PATTERN = 1024


class Matched(NamedTuple):
    """A file that a pattern names."""

    name: str
    """Relative to the folder, with "/" between its parts."""
    key: tuple[int | str, ...]
    """The text that the pattern leaves open, numbers as numbers: equal for files that belong together."""
    frame: int | None = None
    """Number of a frame, where the file is a video."""


def list_images(folder: Path) -> list[str]:
    """Names of all images and videos in a folder and the folders in it, in natural order.

    Raises:
        CaptureError: If it is no folder, cannot be read, or holds too many files.
    """
    if not os.path.isdir(folder):
        found = "found a file" if os.path.exists(folder) else "no such folder"
        raise CaptureError(f"{shown(folder)}: {found}, expected a folder of images.")
    names: list[str] = []
    waiting, seen, folders = [("", 0)], 0, 0
    while waiting:
        inside, depth = waiting.pop()
        folders += 1
        try:
            with os.scandir(folder / inside) as entries:
                for entry in entries:
                    seen += 1
                    if seen > MOST_FILES or folders > MOST_FOLDERS:
                        raise CaptureError(f"{folder}: holds more than {MOST_FILES} files; name a smaller folder.")
                    name = f"{inside}{entry.name}"
                    # Links may lead anywhere, and nothing outside the folder is read.
                    if entry.is_dir(follow_symlinks=False):
                        if depth < DEEPEST and not entry.name.startswith("."):
                            waiting.append((f"{name}/", depth + 1))
                    elif entry.is_file(follow_symlinks=False) and name.lower().endswith((*IMAGES, *VIDEOS)):
                        names.append(name)
        except OSError as problem:
            raise CaptureError(f"{folder / inside}: cannot be read: {problem.strerror or problem}.") from problem
    return sorted(names, key=natural)


def natural(text: str) -> tuple[tuple[bool, int, str], ...]:
    """A key that sorts numbers in names by their value: l_2 before l_10."""
    parts = re.split(r"([0-9]{1,18})", text)
    return tuple((part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts if part)


def match(pattern: str, names: Sequence[str], option: str) -> list[Matched]:
    """The files that a pattern names, in natural order.

    Args:
        pattern: With `*`, `?` and `[...]`, as in a shell; `*` also stands for "/".
        names: All names in the folder.
        option: The option that holds the pattern, for messages.

    Raises:
        OptionError: If the pattern leads out of the folder, or names no file.
    """
    plain = pattern.replace("\\", "/")
    while plain.startswith("./"):
        plain = plain[2:]
    if not plain or len(plain) > _LONGEST_PATTERN or any(ord(letter) < 32 for letter in plain):
        raise OptionError(f"{option}: found {pattern[:60]!r}, expected a pattern such as 'l_*.png'.")
    if plain.startswith("/") or re.match(r"[A-Za-z]:", plain) or ".." in plain.split("/"):
        raise OptionError(f"{option}: found {pattern[:60]!r}, expected a pattern of names inside the folder.")
    expression = _expression(plain)
    found = [Matched(name, _key(hit.groups())) for name in names if (hit := expression.fullmatch(name))]
    if not found:
        raise OptionError(
            f"{option}: no image or video in the folder has a name like '{plain[:60]}'; without patterns, `jaxscan "
            "import FOLDER --show` lists the names."
        )
    return found


def _expression(pattern: str) -> re.Pattern[str]:
    """The pattern as an expression, with a group for each part that it leaves open."""
    parts = re.split(r"(\*+|\?|\[!?\]?[^\]]*\])", pattern)
    # Atomic groups would match less than a shell does; two stars in a row are one, so that nothing is tried twice.
    made = []
    for part in parts:
        if part and set(part) == {"*"}:
            made.append("(.*)")
        elif part == "?" or (part.startswith("[") and part.endswith("]")):
            made.append(f"({fnmatch.translate(part).removeprefix('(?s:').split(')')[0]})")
        else:
            made.append(re.escape(part))
    if sum(part == "(.*)" for part in made) > 4:
        raise OptionError(f"'{pattern[:60]}': found more than four stars, expected a simpler pattern.")
    return re.compile("".join(made), re.DOTALL)


def _key(texts: Sequence[str]) -> tuple[int | str, ...]:
    return numbers_and_words(" ".join(texts))


def numbers_and_words(text: str) -> tuple[int | str, ...]:
    """The numbers and words in a text, in order; everything between them separates.

    A change from small to large letters separates too, so that `laserOn` is two words.
    """
    found = re.findall(r"[0-9]{1,18}|[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text))
    return tuple(int(one) if one.isdecimal() else one.lower() for one in found)
