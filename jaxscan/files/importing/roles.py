"""The roles of images: by the user's patterns, by a known program's layout, or by the words in their names."""

import fnmatch
import itertools
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Literal, NamedTuple

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.importing.plan import ImportRequest, Roles
from jaxscan.files.importing.sources import VIDEOS, Listing, Matched, count_frames, match, natural, numbers_and_words


Role = Literal["on", "off", "texture", "board"]
_MOST_COMPARED = 100

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


class NamedImage(NamedTuple):
    """A file, and the meaning of its name."""

    name: str
    role: Role | None
    side: str | None
    """ "left" or "right", where the name says on which side the laser is."""
    key: tuple[int | str, ...]
    """The rest of the name: equal for files that belong together."""


def understand(name: str) -> NamedImage:
    """The meaning of a file's name, of all its folders too."""
    words = numbers_and_words(name.rpartition(".")[0])
    roles = {_ROLE_OF[word] for word in words if isinstance(word, str) and word in _ROLE_OF}
    role = next((role for role in reversed(_WORDS) if role in roles), None)
    sides = [_SIDE_OF[word] for word in words if isinstance(word, str) and word in _SIDE_OF]
    side = sides[0] if len(set(sides)) == 1 else None
    rest = tuple(
        word for word in words if isinstance(word, int) or (word not in _ROLE_OF and not (side and word in _SIDE_OF))
    )
    return NamedImage(name, role, side, rest)


class Recognised(NamedTuple):
    """The files of a folder by their roles."""

    on: dict[str, list[Matched]]
    """Images by the side of the laser; "" where the names do not say it."""
    off: list[Matched]
    texture: list[Matched]
    board: list[Matched]
    unknown: list[str]


def recognise(names: Sequence[str]) -> Recognised:
    """Sort files by the words in their names."""
    read = [understand(name) for name in names]
    # Left and right count only where there are laser-on images of both sides: a folder may be called so too.
    sided = {one.side for one in read if one.role == "on"} >= {"left", "right"}
    found = Recognised({}, [], [], [], [one.name for one in read if one.role is None])
    for one in read:
        if one.role == "on":
            found.on.setdefault((one.side or "") if sided else "", []).append(Matched(one.name, one.key))
        elif one.role is not None:
            getattr(found, one.role).append(Matched(one.name, one.key))
    return found


class NameGroup(NamedTuple):
    """Files whose names differ in their numbers alone."""

    pattern: str
    files: int
    first: str
    last: str


def group(names: Sequence[str]) -> list[NameGroup]:
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
    return [NameGroup(pattern, files, first[pattern], last[pattern]) for pattern, files in counts.most_common()]


_GROUPS = 8


def find_roles(folder: Path, listing: Listing, request: ImportRequest) -> Roles:
    """Decide which images are laser-on, laser-off and board images.

    Args:
        listing: All images and videos in it.
        request: The user's choices.
    """
    names = listing.images
    if not names:
        left = listing.others_said() or "links are not followed"
        raise CaptureError(f"{folder}: holds no image and no video, expected PNG, JPEG, TIFF or BMP files; {left}.")
    by_patterns = bool(request.on or request.off or request.boards)
    roles = _by_patterns(names, request) if by_patterns else _by_names(folder, names, request)
    said = [sentence for _, files in roles.on for sentence in _in_rows(files, None if by_patterns else folder)]
    return _with_frames(folder, roles._replace(said=(*roles.said, *said)), request.every)


def _in_rows(files: Sequence[Matched], refused_in: Path | None) -> list[str]:
    """A question where the images of one laser are several rows, in folders or by their names: several scans?"""
    inside: dict[str, list[str]] = {}
    for file in files:
        # The row is the name without its last number: `monday/laser_` of `monday/laser_3.png`.
        row = re.sub(r"[0-9]+(?=[^0-9/]*$)", "*", file.name)
        inside.setdefault(row, []).append(re.sub(r".*?([0-9]*)[^0-9/]*$", r"\1", file.name))
    # One image in each row is a layout of steps.
    if len(inside) < 2 or max(map(len, inside.values())) < 2:
        return []
    listed = ", ".join(f"{row} ({len(names)})" for row, names in list(inside.items())[:_GROUPS])
    more = f" and {len(inside) - _GROUPS} more" if len(inside) > _GROUPS else ""
    rows = [set(names) for names in inside.values() if len(names) > 1]
    if refused_in is not None and any(one & other for one, other in itertools.combinations(rows[:_GROUPS], 2)):
        raise CaptureError(
            f"{refused_in}: holds {len(inside)} rows of images that count alike: {listed}{more}; expected one scan. "
            f"Import each by itself, as with --on {shlex.quote(next(iter(inside)))}, or, if they are one, name them by "
            "--on and --off."
        )
    return [f"laser-on images are in {len(inside)} rows, one after the other: {listed}{more}; is this one scan?"]


def _by_names(folder: Path, names: Sequence[str], request: ImportRequest) -> Roles:
    known = _fabscan(names)
    return _by_words(folder, names, request) if known is None else known._replace(on=_renamed(known.on, request))


# FabScanPi is the only other program that keeps captures in a layout that words in names do not tell: Horus keeps no
# images of a scan, and FreeLSS only a thumbnail.


def _fabscan(names: Sequence[str]) -> Roles | None:
    """FabScanPi with `keep_raw_images`: raw_laser_raw/<scan>_NNN.jpg and, from a turn before, color_raw/<scan>_NNN.jpg.

    It turns by 360 degrees over the number of pictures, and takes one laser picture more than that.
    """
    lit = _numbered(names, r"(?:.*/)?raw_laser_[^/]*/[^/]*_([0-9]+)\.jpe?g")
    if not lit:
        return None
    coloured = _numbered(names, r"(?:.*/)?color_[^/]*/[^/]*_([0-9]+)\.jpe?g")
    pictures = len(coloured) if coloured else len(lit) - 1
    step = 360.0 / pictures if pictures > 0 else None
    said = (
        "the layout is that of FabScanPi: the colour images come from another turn under other light, so they are no "
        "laser-off images"
    )
    return Roles((("", lit),), (), (), step, (said,))


def _numbered(names: Sequence[str], expression: str) -> tuple[Matched, ...]:
    found = [(name, re.fullmatch(expression, name, re.IGNORECASE)) for name in names]
    return tuple(Matched(name, (int(hit[1]),)) for name, hit in found if hit and len(hit[1]) <= 18)


def _with_frames(folder: Path, roles: Roles, every: int) -> Roles:
    """The roles with videos replaced by their frames."""
    files = [file for _, group in roles.on for file in group] + [file for group in roles.off for file in group]
    videos = {file.name for file in (*files, *roles.boards) if file.name.lower().endswith(VIDEOS)}
    if not videos:
        return roles
    counted = {name: count_frames(folder, name) for name in sorted(videos)}
    counts = {name: found for name, (found, _) in counted.items()}

    def frames(group: Sequence[Matched]) -> tuple[Matched, ...]:
        made: list[Matched] = []
        for file in group:
            if file.name not in counts:
                made.append(file)
            else:
                made += [Matched(file.name, (*file.key, at), at) for at in range(0, counts[file.name], every)]
        return tuple(made)

    # Frames are paired by their numbers, whatever the names of the videos leave open.
    bare = lambda group: tuple(file._replace(key=()) for file in group) if len(group) == 1 else group
    return roles._replace(
        on=tuple((name, frames(bare(group))) for name, group in roles.on),
        off=tuple(frames(bare(group)) for group in roles.off),
        boards=frames(roles.boards),
        said=(*roles.said, *(_frames_said(name, *numbers) for name, numbers in counted.items())),
    )


def _frames_said(name: str, found: int, announced: int) -> str:
    # Not an error: some recorders count dropped frames, and a duration gives only an estimate.
    doubt = f", but says of itself that it has {announced}: look whether some are missing" if found < announced else ""
    return f"{name} has {found} frames{doubt}"


def _by_patterns(names: Sequence[str], request: ImportRequest) -> Roles:
    for option, patterns in (("--on", request.on), ("--off", request.off), ("--boards", request.boards)):
        if len(patterns) > 16:
            raise OptionError(
                f"{option}: found {len(patterns)} patterns, expected one, or one for each laser or exposure; put the "
                f"pattern in quotes, so that the shell does not expand it: {option} 'l_*.png'."
            )
    on = [tuple(match(pattern, names, "--on")) for pattern in request.on]
    off = tuple(tuple(match(pattern, names, "--off")) for pattern in request.off)
    boards = [file for pattern in request.boards for file in match(pattern, names, "--boards")]
    _refuse_doubles([("--on", on), ("--off", off), ("--boards", [boards] if boards else [])])
    said = [
        sentence
        for patterns, lists in ((request.on, on), (request.off, off))
        for pattern, files in zip(patterns, lists, strict=True)
        for sentence in _several_kinds(pattern, files)
    ]
    several = len(on) > 1 and not request.exposures_ms
    groups = tuple((f"laser {k + 1}" if several else "", files) for k, files in enumerate(on))
    return Roles(_renamed(groups, request), off, tuple(boards), None, tuple(said))


def _several_kinds(pattern: str, files: Sequence[Matched]) -> list[str]:
    """A sentence where a pattern names more than a row of numbered files: perhaps the images of another scan too."""
    kinds = group([file.name for file in files])
    if len(kinds) == 1:
        return []
    listed = ", ".join(f"'{one.pattern}' ({one.files})" for one in kinds[:_GROUPS])
    more = f" and {len(kinds) - _GROUPS} more" if len(kinds) > _GROUPS else ""
    return [f"'{pattern}' names {len(kinds)} kinds of files, one after the other: {listed}{more}; is this one scan?"]


def _refuse_doubles(groups: Sequence[tuple[str, Sequence[Sequence[Matched]]]]) -> None:
    seen: dict[str, str] = {}
    for option, lists in groups:
        for file in (file for files in lists for file in files):
            if file.name in seen:
                raise OptionError(f"{seen[file.name]} and {option}: both name {file.name}; expected patterns apart.")
            seen[file.name] = option


def _renamed(
    on: tuple[tuple[str, tuple[Matched, ...]], ...], request: ImportRequest
) -> tuple[tuple[str, tuple[Matched, ...]], ...]:
    """Groups with the lasers' names that the user gives."""
    if not request.lasers:
        return on
    if len(request.lasers) != len(on) or len(set(request.lasers)) != len(request.lasers):
        raise OptionError(
            f"--lasers: found {', '.join(request.lasers)}, expected {len(on)} different names, one for each laser."
        )
    return tuple((name, files) for name, (_, files) in zip(request.lasers, on, strict=True))


def _by_words(folder: Path, names: Sequence[str], request: ImportRequest) -> Roles:
    found = recognise(names)
    on = tuple((side, tuple(files)) for side, files in sorted(found.on.items()))
    said = ["the roles of the images are read from the words in their names"]
    if request.board is not None and not on and (plain := _painted(found)) is not None:
        said = [
            f"'{plain.pattern}' ({plain.files}) show the board: as many images in a folder below, as "
            f"{found.board[0].name}, are taken for copies with painted corners; --boards names others"
        ]
        found = found._replace(board=match(plain.pattern, found.unknown, "--boards"), unknown=[])
    if found.texture:
        said.append(
            f"texture images ({len(found.texture)}) are not used, for they may have another exposure; where they do "
            "not, --off names them"
        )
    boards = tuple(sorted(found.board, key=lambda file: natural(file.name))) if request.board is not None else ()
    if request.board is not None and not on and not boards:
        boards = tuple(Matched(name, ()) for name in found.unknown) if len(group(found.unknown)) == 1 else ()
        boards = tuple(match(group(found.unknown)[0].pattern, found.unknown, "--boards")) if boards else ()
        said = ["all images show the board"] if boards else said
    if not on and not boards:
        raise CaptureError(_not_recognised(folder, names, request))
    if found.unknown and (on or found.board):
        said.append(f"other images ({len(found.unknown)}) are not used: their names say nothing, as {found.unknown[0]}")
    if found.board and request.board is None:
        said.append(f"images of a board ({len(found.board)}) are not used: --board says which board it is")
    return Roles(_renamed(on, request), (tuple(found.off),) if found.off else (), boards, None, tuple(said))


def _painted(found: Recognised) -> NameGroup | None:
    """The images of which those of the board are copies: as many, in a folder above; None where they are no copies.

    Programs that find corners paint them into copies, and put these into a folder that says what they show.
    """
    plain, copies = group(found.unknown), group([file.name for file in found.board])
    if len(plain) != 1 or len(copies) != 1 or plain[0].files != copies[0].files:
        return None
    above = PurePath(plain[0].first).parent in PurePath(copies[0].first).parent.parents
    return plain[0] if above else None


def _not_recognised(folder: Path, names: Sequence[str], request: ImportRequest) -> str:
    """The groups of names, and the command to type."""
    groups = group(names)
    listed = "; ".join(f"'{one.pattern}' ({one.files}: {one.first} ... {one.last})" for one in groups[:_GROUPS])
    more = f"; and {len(groups) - _GROUPS} more" if len(groups) > _GROUPS else ""
    pattern = shlex.quote(groups[0].pattern)
    moves = "" if request.carries is None else f" --carries {request.carries}"
    moves += {"linear": " --step-mm 1", "poses": " --poses poses.txt", "nothing": ""}.get(
        request.carries or "", " --step-deg 0.9"
    )
    if request.board is not None:
        command = f"--boards {pattern}"
    elif len(groups) > 1:
        command = f"--on {pattern} --off {shlex.quote(groups[1].pattern)}{moves}"
    else:
        command = f"--on {pattern}{moves}, or --boards {pattern} --board 'chessboard 11x6 13mm'"
    return (
        f"{folder}: the names do not say which images have the laser on. Found {listed}{more}. Expected, for example: "
        f"jaxscan import {shlex.quote(str(folder))} {command}"
    )
