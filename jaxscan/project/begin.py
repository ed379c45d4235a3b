"""A first `project.toml` for the captures and calibrations that lie in a folder."""

import glob
import json
import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jaxscan import api
from jaxscan.errors import CalibrationError, ConfigError, JaxscanError
from jaxscan.files.calibration import load_scanner
from jaxscan.files.capture import HEADER_NAME, CaptureHeader, TurntableTable, open_capture, parse_header
from jaxscan.files.disk import MEGABYTE, read_bounded
from jaxscan.geometry import Scanner
from jaxscan.project.project import ABOUT, Project


DEEPEST = 4
MOST_FOLDERS = 100_000
_BEGINNING = """\
# What there is, and what is wanted of it. `jaxscan batch project.toml` makes what is missing or stale.

[project]
name = {name}
products = ["cloud", "measures"]  # also "mesh", "plan", "panorama", "report"
formats = ["ply"]  # of clouds; also "e57", "las", "laz", "npz", "pcd", "ptx", "xyz"
"""


class Found(NamedTuple):
    """A capture that lies in the folder."""

    path: Path
    """Path relative to the folder."""
    header: CaptureHeader


def project_text(folder: Path) -> str:
    """The text of a project file for what lies in a folder, four folders deep.

    Sweeps of the same camera, laser and table are of one rig. Its calibration is the file that fits the size of its
    images, or is made from captures of a board by the same camera and laser, if they say nothing else of the table.
    Where they say that it carries things, or nothing, they have products of their own.

    Raises:
        ConfigError: If there is no sweep, or not one calibration for a rig.
        CaptureError: If a capture's header cannot be read.
    """
    folders, files = _walked(folder)
    captures = [Found(path, _header(folder / path)) for path in folders]
    sweeps = [one for one in captures if one.header.kind == "sweep"]
    if not sweeps:
        raise ConfigError(f"{folder}: found no sweep in it, expected folders of captures with {HEADER_NAME}.")
    calibrations = [path for path in files if _is_calibration(folder / path)]
    text = _BEGINNING.format(name=_quoted(_name(folder)))
    boards = _alike([one for one in captures if one.header.kind == "calibration"])
    rigs = _alike(sweeps)
    for number, own in enumerate(rigs, 1):
        name = "rig" if len(rigs) == 1 else f"rig-{number}"
        text += f'\n[[rig]]\nname = "{name}"\n{_calibration(folder, own[0], calibrations, boards)}'
        for pattern in _patterns(own, captures):
            text += f'\n[[captures]]\npattern = {_quoted(pattern)}\nrig = "{name}"\n{_products(own[0].header)}'
    return text


def board_notes(project: Project) -> list[str]:
    """Sentences on parts that the boards of a new project leave open, said now rather than by its batch."""
    notes = []
    for rig in project.wanted.rig:
        places = [str(Path(project.file.parent, place)) for place in rig.boards]
        if not places:
            continue
        try:
            missing = api.plan_calibration([open_capture(place, compare=False) for place in places]).missing
        except JaxscanError as problem:
            notes.append(str(problem))
            continue
        notes += [f"{' and '.join(rig.boards)}: {sentence}" for sentence in missing]
        if missing:
            notes.append(
                f"sweeps that need it give no cloud. What is known, an axis too, goes to `jaxscan calibrate "
                f"{' '.join(rig.boards)}`, and the file that it writes to {project.file.name} in place of the boards."
            )
    return notes


def _walked(folder: Path) -> tuple[list[Path], list[Path]]:
    """Folders that hold a capture, none inside of another one; and files that may be calibrations. From `folder`."""
    captures: list[Path] = []
    files: list[Path] = []
    for looked, (here, below, names) in enumerate(os.walk(folder)):
        if looked >= MOST_FOLDERS:
            raise ConfigError(f"{folder}: holds more than {MOST_FOLDERS} folders; name one further down.")
        path = Path(here).relative_to(folder)
        is_capture = HEADER_NAME in names
        captures += [path] if is_capture else []
        if ABOUT in names:
            # The products of a batch: its calibrations are not inputs.
            below[:] = []
            continue
        files += [] if is_capture else [path / name for name in sorted(names) if name.endswith(".json")]
        below[:] = [] if is_capture or len(path.parts) >= DEEPEST else sorted(below)
    return sorted(captures), sorted(files)


def _header(path: Path) -> CaptureHeader:
    name = path / HEADER_NAME
    return parse_header(read_bounded(name, MEGABYTE, error=ConfigError), name=str(name))


def _is_calibration(path: Path) -> bool:
    try:
        load_scanner(path)
    except CalibrationError:
        return False
    return True


def _alike(captures: Sequence[Found]) -> list[list[Found]]:
    """Captures by the camera, laser, table and board of their headers: those that can be calibrated together."""
    groups: list[list[Found]] = []
    for one in captures:
        same = next((group for group in groups if _parts(group[0].header) == _parts(one.header)), None)
        if same is None:
            groups.append([one])
        else:
            same.append(one)
    return groups


def _parts(header: CaptureHeader) -> tuple[object, ...]:
    return header.camera, header.laser, header.turntable, header.board


def _products(header: CaptureHeader) -> str:
    """The line for captures that do not show a room; "" for those that allow the project's products."""
    carries = None if header.turntable is None else header.turntable.carries
    if carries == "nothing":
        return 'products = ["cloud"]  # profiles of a scanner that stands still; also "measures", "report"\n'
    if carries == "object":
        return 'products = ["cloud", "mesh"]  # things on a table are no rooms; also "measures", "report"\n'
    return ""


def _calibration(folder: Path, sweep: Found, calibrations: Sequence[Path], boards: Sequence[Sequence[Found]]) -> str:
    """The line of a rig that names its calibration."""
    why = {path: _unfit(load_scanner(folder / path), sweep.header) for path in calibrations}
    fits = [path for path in calibrations if not why[path]]
    if len(fits) == 1:
        return f"calibration = {_quoted(fits[0].as_posix())}\n"
    if len(fits) > 1:
        names = " and ".join(path.as_posix() for path in fits[:3])
        raise ConfigError(f"{folder}: {len(fits)} calibrations fit the rig of {sweep.path} ({names}); keep one.")
    others = {path: [what] for path, what in why.items() if what} | {
        group[0].path: _differs(group[0].header, sweep.header) for group in boards
    }
    serve = [group for group in boards if not others[group[0].path]]
    # Boards that say the same of all parts come before those that leave some of them open.
    same = [group for group in serve if _parts(group[0].header)[:3] == _parts(sweep.header)[:3]]
    for chosen in (same, serve):
        if len(chosen) == 1:
            return f"boards = [{', '.join(_quoted(one.path.as_posix()) for one in chosen[0])}]\n"
    if serve:
        names = " and ".join(group[0].path.as_posix() for group in serve[:3])
        raise ConfigError(
            f"{folder}: {len(serve)} kinds of boards may be of the rig of {sweep.path} ({names}); keep one of them."
        )
    seen = "".join(f"; {path} has another {' and '.join(what)}" for path, what in list(others.items())[:3])
    raise ConfigError(
        f"{folder}: found neither a calibration nor captures of a board for the rig of {sweep.path}{seen}."
    )


def _differs(board: CaptureHeader, sweep: CaptureHeader) -> list[str]:
    """The parts of a rig in which a capture of a board differs from a sweep; parts that it leaves open may be the same.

    How images were stored says nothing of the rig, and the colour of a laser is a way of looking for it.
    """
    what = []
    if (board.camera.width, board.camera.height) != (sweep.camera.width, sweep.camera.height):
        what.append("size of image")
    if [(one.name, one.stripe_axis) for one in board.laser] != [(one.name, one.stripe_axis) for one in sweep.laser]:
        what.append("laser")
    if board.turntable is not None and board.turntable != (sweep.turntable or TurntableTable()):
        what.append("turntable")
    return what


def _unfit(scanner: Scanner, sweep: CaptureHeader) -> str:
    """The part of a rig in which a calibration differs from a sweep; "" where it fits."""
    if (scanner.camera.width, scanner.camera.height) != (sweep.camera.width, sweep.camera.height):
        return "size of image"
    moves = None if sweep.turntable is None else sweep.turntable.carries
    carries = scanner.turntable.carries
    return "" if moves in (None, carries) else f'carries = "{carries}"'


def _patterns(sweeps: Sequence[Found], captures: Sequence[Found]) -> list[str]:
    """Patterns that find these sweeps and no other capture. One that finds several also finds what is added later."""
    own, patterns = {one.path for one in sweeps}, list[str]()
    in_folder = Counter(path.parent for path in own)
    beside, alike = defaultdict[Path, list[Path]](list), defaultdict[tuple[Path, str], list[Path]](list)
    for one in captures:
        beside[one.path.parent].append(one.path)
        alike[one.path.parent.parent, one.path.name].append(one.path)

    known: dict[str, frozenset[Path]] = {}

    def found(pattern: str, near: Path) -> frozenset[Path]:
        """The sweeps that a pattern finds; none if it finds others too, or places that it would not look into."""
        if pattern not in known:
            places = [*beside[near.parent], *alike[near.parent.parent, near.name]]
            depth = len(Path(pattern).parts)
            some = frozenset(path for path in places if len(path.parts) == depth and path.match(pattern))
            hidden = any(part.startswith(".") for path in some for part in path.parts)
            # Folders of rooms with one sweep each; if they hold several, the sweeps are named after the rooms.
            crowded = len({path.parent for path in some}) > 1 and any(in_folder[path.parent] > 1 for path in some)
            known[pattern] = some if some <= own and not hidden and not crowded else frozenset()
        return known[pattern]

    left = set(own)
    for path in sorted(own):
        if path in left:
            *wide, itself = _candidates(path)
            best = max(wide, key=lambda one: len(found(one, path) & left))
            several = found(best, path) & left
            patterns.append(best if len(several) > 1 else itself)
            left -= several if len(several) > 1 else {path}
    return patterns


def _candidates(path: Path) -> list[str]:
    """Patterns that find a sweep: with all others beside it, with those that begin alike, with those of other rooms,
    and alone."""
    parent, name = Path(glob.escape(str(path.parent))), glob.escape(path.name)
    begins = re.match(r"[A-Za-z]*[^A-Za-z0-9]*", path.name)
    same = [parent / f"{glob.escape(begins[0])}*"] if begins and begins[0] else []
    rooms = [Path(glob.escape(str(path.parent.parent))) / "*" / name] if path.parent.name else []
    return [one.as_posix() for one in (parent / "*", *same, *rooms, parent / name)]


def _name(folder: Path) -> str:
    name = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in folder.absolute().name)
    return name.strip("-")[:64] or "project"


def _quoted(text: str) -> str:
    """A string in the syntax of TOML. JSON's is the same, except for letters beyond 16 bits and the delete character.

    Raises:
        ConfigError: If it is the name of a file that is no text.
    """
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ConfigError(f"{text!r}: the name of this folder or file is no text in UTF-8; rename it.") from None
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
