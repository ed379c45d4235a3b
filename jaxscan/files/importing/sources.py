"""The images and videos of other programs: their names, the patterns that choose them, and the board that they show."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.capture import BoardTable
from jaxscan.files.disk import FileModel, check, open_regular, shown


if TYPE_CHECKING:
    from jaxscan.vision import Video


class Source(NamedTuple):
    """An image file, or a frame of a video."""

    name: str
    """Relative to the folder, with "/" between its parts."""
    frame: int | None = None

    def __str__(self) -> str:
        return self.name if self.frame is None else f"{self.name}#{self.frame}"


class Matched(NamedTuple):
    """A file that a pattern names."""

    name: str
    """Relative to the folder, with "/" between its parts."""
    key: tuple[int | str, ...]
    """The text that the pattern leaves open, numbers as numbers: equal for files that belong together."""
    frame: int | None = None

    @property
    def source(self) -> Source:
        """The file or frame alone."""
        return Source(self.name, self.frame)


_FORMS = {
    "chessboard": ("square_mm",),
    "charuco": ("square_mm", "marker_mm"),
    "circles": ("spacing_mm", "diameter_mm"),
    "aprilgrid": ("tag_mm", "gap_mm"),
}
_EXAMPLES = (
    '"chessboard 11x6 13mm" (inner corners, square), "charuco 12x9 30mm 22mm DICT_5X5_250" (squares, square, marker; '
    "with the word legacy behind where OpenCV before 4.6 printed it), "
    '"circles 4x11 20mm 16mm" (circles, distance of rows, diameter; with the word symmetric behind where no row is '
    'shifted) or "aprilgrid 6x6 24mm 7.2mm" (tags, tag, gap)'
)
_LAYOUTS = ("legacy", "standard")
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


class _Given(FileModel):
    board: BoardTable


def parse_board(text: str) -> BoardTable:
    """The board that a text describes: its kind, its columns and rows, and its lengths.

    Raises:
        OptionError: If it is understood as none.
    """
    words = re.sub(r"(?<=[0-9]) +(?=(?:mm|cm|m)\b)", "", text[:200]).split()
    kind = words[0].lower() if words else ""
    counts = re.fullmatch(r"([0-9]{1,6})[xX×]([0-9]{1,6})", words[1]) if len(words) > 1 else None
    lengths = [re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)(mm|cm|m)", word) for word in words[2:]]
    known = [length for length in lengths if length]
    rest = [word for word, length in zip(words[2:], lengths, strict=True) if not length]
    # Each word behind the lengths says one thing.
    more = {"charuco": ("dictionary", "layout"), "circles": ("layout",)}.get(kind, ())
    words_of = {
        "layout" if word.lower() in _LAYOUTS or "dictionary" not in more else "dictionary": word for word in rest
    }
    understood = len(words_of) == len(rest) and set(words_of) <= set(more)
    if kind not in _FORMS or counts is None or len(known) != len(_FORMS[kind]) or not understood:
        raise OptionError(f"--board: found {text[:80]!r}, expected {_EXAMPLES}.")
    table = {"type": kind, "columns": int(counts[1]), "rows": int(counts[2])}
    table |= {key: float(hit[1]) * _UNITS[hit[2]] for key, hit in zip(_FORMS[kind], known, strict=True)}
    table |= {key: word.lower() if key == "layout" else word for key, word in words_of.items()}
    return check(_Given, {"board": table}, name="--board", error=OptionError).board


MOST_FILES = 200_000
MOST_FOLDERS = 10_000
DEEPEST = 8
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
VIDEOS = (".avi", ".mp4", ".mov", ".m4v", ".mkv", ".webm")
_OTHER_IMAGES = (
    *(".heic", ".heif", ".avif", ".webp", ".gif", ".jp2", ".jxl", ".psd", ".exr", ".fits", ".pgm", ".ppm", ".pnm"),
    *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".raw", ".bin", ".npy"),
)
_LONGEST_PATTERN = 1024


class Listing(NamedTuple):
    """The files of a folder and the folders in it."""

    images: list[str]
    others: Counter[str]
    """Numbers of files by suffix that are images, and not read."""

    def others_said(self) -> str:
        """A note on files that are not read, with the remedy; empty where there are none."""
        if not self.others:
            return ""
        counts = ", ".join(f"{count} {suffix}" for suffix, count in self.others.most_common(4))
        return f"{counts} files are not read: convert them to PNG or TIFF, of 8 or 16 bits (telephones: to JPEG)"


def list_images(folder: Path) -> Listing:
    """All images and videos in a folder and the folders in it.

    Raises:
        CaptureError: If it is no folder, cannot be read, or holds too many files.
    """
    if not os.path.isdir(folder):
        found = "found a file" if os.path.exists(folder) else "no such folder"
        raise CaptureError(f"{shown(folder)}: {found}, expected a folder of images.")
    names: list[str] = []
    others: Counter[str] = Counter()
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
                    elif entry.is_file(follow_symlinks=False):
                        suffix = os.path.splitext(name)[1].lower()
                        others.update([suffix] if suffix in _OTHER_IMAGES else [])
        except OSError as problem:
            raise CaptureError(f"{folder / inside}: cannot be read: {problem.strerror or problem}.") from problem
    return Listing(sorted(names, key=natural), others)


def natural(text: str) -> tuple[tuple[bool, int, str], ...]:
    """A key that sorts numbers in names by their value: l_2 before l_10."""
    parts = re.split(r"([0-9]{1,18})", text)
    return tuple((part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts if part)


def match(pattern: str, names: Sequence[str], option: str) -> list[Matched]:
    """The files that a pattern names, in natural order.

    Args:
        pattern: With `*`, `?` and `[...]`, as in a shell; `*` also stands for "/".
        names: All names in the folder.
    """
    plain = pattern.replace("\\", "/")
    while plain.startswith("./"):
        plain = plain[2:]
    if not plain or len(plain) > _LONGEST_PATTERN or any(ord(letter) < 32 for letter in plain):
        raise OptionError(f"{option}: found {pattern[:60]!r}, expected a pattern such as 'l_*.png'.")
    if plain.startswith("/") or re.match(r"[A-Za-z]:", plain) or ".." in plain.split("/"):
        raise OptionError(f"{option}: found {pattern[:60]!r}, expected a pattern of names inside the folder.")
    shape = _compiled(plain)
    parts = [(name, _open_part(shape, name)) for name in names]
    found = [Matched(name, numbers_and_words(text)) for name, text in parts if text is not None]
    if not found:
        raise OptionError(
            f"{option}: no image or video in the folder has a name like '{plain[:60]}'; without patterns, `jaxscan "
            "import FOLDER --show` lists the names."
        )
    return found


def _compiled(pattern: str) -> re.Pattern[str]:
    """A pattern as an expression with a group for each open part.

    Each piece between two stars is looked for once, by an atomic group: no name makes a pattern slow.
    """
    first, *middle = (_piece(text) for text in re.split(r"\*+", pattern))
    last = f"(.*){middle.pop()}" if middle else ""
    try:
        return re.compile("".join([first, *(f"(?>(.*?){piece})" for piece in middle), last]), re.DOTALL)
    except re.error as problem:
        raise OptionError(
            f"{pattern[:60]!r}: found a pattern with wrong brackets ({problem}), expected [abc]."
        ) from problem


def _piece(text: str) -> str:
    """A part of a pattern without stars as an expression."""
    made = []
    for letter in re.findall(r"\[!?\]?[^\]]*\]|.", text, re.DOTALL):
        if letter == "?":
            made.append("(.)")
        elif len(letter) > 1:
            inside = re.sub(r"([\\^\[\]&~|])", r"\\\1", letter[1:-1].removeprefix("!"))
            made.append(f"([{'^' if letter[1] == '!' else ''}{inside}])")
        else:
            made.append(re.escape(letter))
    return "".join(made)


def _open_part(shape: re.Pattern[str], name: str) -> str | None:
    """A name with blanks in place of what its pattern fixes; None where it does not match."""
    hit = shape.fullmatch(name)
    if hit is None:
        return None
    is_open = {at for start, end in hit.regs[1:] for at in range(start, end)}
    return "".join(letter if at in is_open else " " for at, letter in enumerate(name))


def numbers_and_words(text: str) -> tuple[int | str, ...]:
    """The numbers and words in a text, in order; everything between them separates.

    A change from small to large letters separates too, so that `laserOn` is two words.
    """
    found = re.findall(r"[0-9]{1,18}|[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text))
    return tuple(int(one) if one.isdecimal() else one.lower() for one in found)


# Videos.


def open_video(folder: Path, name: str) -> "Video":
    """A video in an untrusted folder."""
    from jaxscan.vision import Video
    from jaxscan.vision.video import BEGINNING_BYTES

    path = Path(os.path.abspath(folder / name))
    with open_regular(path, error=CaptureError, links="refuse") as file:
        beginning = file.read(BEGINNING_BYTES)
    return Video(str(path), beginning)


def count_frames(folder: Path, name: str) -> tuple[int, int]:
    """Number of frames of a video, and the number that the file says it has; 0 if it does not say.

    Raises:
        CaptureError: If it cannot be read, has none, or is cut short.
    """
    from jaxscan.vision.video import is_cut_short

    video = open_video(folder, name)
    try:
        found = video.count()
    finally:
        video.close()
    path = folder / name
    if not found:
        raise CaptureError(f"{path}: no frame can be decoded; the file is damaged, or its codec is not known.")
    with open_regular(path, error=CaptureError, links="refuse") as file:
        short = is_cut_short(file)
    if short:
        of = f"of {video.announced} " if video.announced >= found else ""
        raise CaptureError(
            f"{path}: the file ends before its own header says, in or after frame {found} {of}(the last may be "
            "damaged): copy it again, or cut it cleanly with a video program."
        )
    return found, video.announced
