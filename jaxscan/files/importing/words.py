"""Recognition of images by the words in their names."""

import fnmatch
import re
from collections import Counter
from collections.abc import Sequence
from typing import Literal, NamedTuple

from jaxscan.files.importing.listing import VIDEOS, Matched, numbers_and_words


Role = Literal["on", "off", "texture", "board"]
_MOST_COMPARED = 100
"""Groups of names that are compared with one another."""
ROLES: tuple[Role, ...] = ("on", "off", "texture", "board")

# English, German, French, Spanish and Italian. A name with a word of a later row has its role, whatever else it says.
_WORDS: dict[Role, str] = {
    "board": "board boards pattern chess chessboard checker checkerboard charuco aruco aprilgrid calib calibration "
    "schachbrett muster kalibrierung damier mire patron tablero calibracion scacchiera calibrazione",
    "texture": "texture textures colour color rgb textur farbe couleur textura testura colore",
    "on": "laser lasers line stripe lit on linie streifen ligne raie linea raya",
    "off": "background off bg dark ambient unlit nolaser without hintergrund aus ohne fond sans eteint fondo apagado "
    "sin sfondo spento senza",
}
_SIDES = {
    "left": "left l links gauche izquierda izquierdo sinistra sinistro",
    "right": "right r rechts droite derecha derecho destra destro",
}
_ROLE_OF: dict[str, Role] = {word: role for role, words in _WORDS.items() for word in words.split()}
_SIDE_OF = {word: side for side, words in _SIDES.items() for word in words.split()}


class Named(NamedTuple):
    """A file, and the meaning of its name."""

    name: str
    role: Role | None
    side: str | None
    """ "left" or "right", where the name says on which side the laser is."""
    key: tuple[int | str, ...]
    """The rest of the name: equal for files that belong together."""


def understand(name: str) -> Named:
    """The meaning of a file's name, of all its folders too."""
    words = numbers_and_words(name.rpartition(".")[0])
    roles = {_ROLE_OF[word] for word in words if isinstance(word, str) and word in _ROLE_OF}
    role = next((role for role in reversed(_WORDS) if role in roles), None)
    sides = [_SIDE_OF[word] for word in words if isinstance(word, str) and word in _SIDE_OF]
    side = sides[0] if len(set(sides)) == 1 else None
    rest = tuple(
        word for word in words if isinstance(word, int) or (word not in _ROLE_OF and not (side and word in _SIDE_OF))
    )
    return Named(name, role, side, rest)


class Recognised(NamedTuple):
    """The files of a folder by their roles."""

    on: dict[str, list[Matched]]
    """By the side of the laser, "" where the names do not say."""
    off: list[Matched]
    texture: list[Matched]
    board: list[Matched]
    unknown: list[str]


def recognise(names: Sequence[str]) -> Recognised:
    """Sort files by the words in their names.

    Left and right count only where there are laser-on images of both sides: a folder may be called so too.
    """
    read = [understand(name) for name in names]
    sides = {one.side for one in read if one.role == "on"}
    sided = sides >= {"left", "right"}
    found = Recognised({}, [], [], [], [one.name for one in read if one.role is None])
    for one in read:
        file = Matched(one.name, one.key)
        if one.role == "on":
            found.on.setdefault((one.side or "") if sided else "", []).append(file)
        elif one.role is not None:
            getattr(found, one.role).append(file)
    return found


class Group(NamedTuple):
    """Files whose names differ in their numbers alone."""

    pattern: str
    files: int
    first: str
    last: str


def group(names: Sequence[str]) -> list[Group]:
    """Groups of files, the largest first; `names` in natural order.

    A pattern that would name files of another group too asks for a digit: `step[0-9]*.jpg` beside `step_table*.jpg`.
    """
    patterns = [re.sub(r"[0-9]+", "*", name) for name in names]
    kinds = set(patterns) if len(set(patterns)) <= _MOST_COMPARED else set()
    wide = {one for one in kinds if any(other != one and fnmatch.fnmatchcase(other, one) for other in kinds)}
    patterns = [one.replace("*", "[0-9]*") if one in wide else one for one in patterns]
    counts = Counter(patterns)
    first: dict[str, str] = {}
    last: dict[str, str] = {}
    for pattern, name in zip(patterns, names, strict=True):
        first.setdefault(pattern, name)
        last[pattern] = name
    return [Group(pattern, files, first[pattern], last[pattern]) for pattern, files in counts.most_common()]


def is_video(name: str) -> bool:
    """Whether a file's name is that of a video."""
    return name.lower().endswith(VIDEOS)
