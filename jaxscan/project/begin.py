"""A first `project.toml` for the captures and calibrations that lie in a folder."""

import glob
import json
import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import CalibrationError, ConfigError
from jaxscan.files.calibration import load_scanner
from jaxscan.files.capture import HEADER_NAME, CaptureHeader, parse_header
from jaxscan.files.disk import MEGABYTE, read_bounded
from jaxscan.project.claim import ABOUT


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
    """From the folder."""
    header: CaptureHeader


def project_text(folder: Path) -> str:
    """The text of a project file for what lies in a folder, four folders deep.

    Captures of the same camera, laser and table are of one rig. Its calibration is the file that fits the size of its
    images, or is made from its captures of a board.

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
    rigs = _rigs(captures)
    for number, members in enumerate(rigs, 1):
        own = [one for one in members if one.header.kind == "sweep"]
        if own:
            name = "rig" if len(rigs) == 1 else f"rig-{number}"
            text += f'\n[[rig]]\nname = "{name}"\n{_calibration(folder, members, calibrations)}'
            for pattern in _patterns(own, captures):
                text += f'\n[[captures]]\npattern = {_quoted(pattern)}\nrig = "{name}"\n'
    return text


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
            # The products of a batch: what it calibrated is not given.
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


def _rigs(captures: Sequence[Found]) -> list[list[Found]]:
    """Captures by the camera, laser and table of their headers."""
    rigs: list[list[Found]] = []
    for one in captures:
        same = next((rig for rig in rigs if _parts(rig[0].header) == _parts(one.header)), None)
        if same is None:
            rigs.append([one])
        else:
            same.append(one)
    return rigs


def _parts(header: CaptureHeader) -> tuple[object, ...]:
    return header.camera, header.laser, header.turntable


def _calibration(folder: Path, members: Sequence[Found], calibrations: Sequence[Path]) -> str:
    camera = members[0].header.camera
    fits = [path for path in calibrations if _size(folder / path) == (camera.width, camera.height)]
    boards = [one.path.as_posix() for one in members if one.header.kind == "calibration"]
    if len(fits) == 1:
        return f"calibration = {_quoted(fits[0].as_posix())}\n"
    if len(fits) > 1:
        names = " and ".join(path.as_posix() for path in fits[:3])
        raise ConfigError(f"{folder}: {len(fits)} calibrations fit the rig of {members[0].path} ({names}); keep one.")
    if not boards:
        raise ConfigError(
            f"{folder}: found neither a calibration nor captures of a board for the rig of {members[0].path}."
        )
    return f"boards = [{', '.join(map(_quoted, boards))}]\n"


def _size(path: Path) -> tuple[int, int]:
    camera = load_scanner(path).camera
    return camera.width, camera.height


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
            # Folders of rooms, each with its one sweep; where they hold several, the sweeps have the names of rooms.
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
    """Patterns that find a sweep: with all beside it, those that begin alike, those of other rooms; and alone."""
    parent, name = Path(glob.escape(str(path.parent))), glob.escape(path.name)
    begins = re.match(r"[A-Za-z]*[^A-Za-z0-9]*", path.name)
    same = [parent / f"{glob.escape(begins[0])}*"] if begins and begins[0] else []
    rooms = [Path(glob.escape(str(path.parent.parent))) / "*" / name] if path.parent.name else []
    return [one.as_posix() for one in (parent / "*", *same, *rooms, parent / name)]


def _name(folder: Path) -> str:
    name = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in folder.absolute().name)
    return name.strip("-")[:64] or "project"


def _quoted(text: str) -> str:
    """A string as TOML has it: JSON's are the same, but for letters beyond 16 bits and the one that deletes.

    Raises:
        ConfigError: If it is the name of a file that is no text.
    """
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ConfigError(f"{text!r}: the name of this folder or file is no text in UTF-8; rename it.") from None
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
