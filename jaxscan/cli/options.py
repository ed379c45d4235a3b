"""Options that several verbs share, and checks before the work begins: of values, and of files that would be lost."""

import errno
import math
import os
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from jaxscan.cli.help import Arg
from jaxscan.cli.terminal import json_target
from jaxscan.errors import DependencyError, OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import capture as capture_files
from jaxscan.files import disk
from jaxscan.files.clouds import FORMATS
from jaxscan.files.disk import COPY_FIRST, is_address
from jaxscan.geometry.cameras.registry import MODELS
from jaxscan.geometry.motion_kinds import MOTIONS
from jaxscan.geometry.motion_kinds import Carries as Carries


CapturePath = Annotated[Path, Arg("CAPTURE")]
CloudPath = Annotated[Path, Arg("CLOUD")]
ConfigPath = Annotated[Path, Arg("CONFIG")]
OutputPath = Annotated[Path, Arg(short="-o")]
CloudUnit = Annotated[
    Literal["m", "cm", "mm", "inch", "foot", "us-foot"] | None,
    Arg(text="Unit of a cloud of another program; without, it is guessed where the file does not say it."),
]
CloudColumns = Annotated[
    str | None,
    Arg(
        "NAMES",
        text="Columns of a text, PLY or PCD of another program in their order: x, y, z, i (intensity), r, g, b, nx, "
        "ny, nz, sigma_random, and - for one to leave out.",
    ),
]
CloudColours = Annotated[
    Literal["1", "255", "1023", "4095", "65535", "none"] | None,
    Arg(text="Number of full brightness in a cloud of another program; none leaves its colours out."),
]
CloudUp = Annotated[
    Literal["x", "-x", "y", "-y", "z", "-z"] | None,
    Arg(text="Direction of the cloud that is up: it becomes z. Ours have z up."),
]
# Choices of other rooms, written out so that `--help` does not load them; a test compares them.
Part = Literal["camera", "sheet", "axis"]
RigKind = Literal["camera", "profile", "axis"]
_LENSES = tuple(block for blocks in MODELS.values() for block in blocks)
_MOTIONS = tuple(block for kind in MOTIONS.values() for block in kind.blocks)
_BLOCKS = ("focal", "centre", *_LENSES, "laser", "bow", *_MOTIONS, "warp", "pitch", "shape")
if TYPE_CHECKING:
    Block = str
else:
    Block = Literal[tuple(dict.fromkeys(_BLOCKS))]
Choice = Literal["path", "brightest", "nearest", "farthest", "all"]
Smooth = Literal["off", "edge"]
MIN_RANGE_M, MAX_RANGE_M = 0.05, 30.0
Paper = Literal["A4", "A3", "A2", "A1", "letter"]
CameraFormat = Literal["opencv", "ros", "mrcal", "kalibr"]
Storage = Literal["zstd", "png", "npy"]
PixelFormat = Literal["mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"]
LaserColour = Literal["auto", "red", "green", "blue"]
StripeAxis = Literal["rows", "columns"]
ImageUp = Literal["-v", "+v", "+u", "-u"]
CLOUD_SUFFIXES = " ".join(FORMATS)
"""Suffixes of all formats of clouds, as help and messages show them."""
CloudOutputPath = Annotated[
    Path,
    Arg(short="-o", text=f"Cloud to write; the suffix chooses the format ({CLOUD_SUFFIXES})."),
]
CalibrationPath = Annotated[Path, Arg(short="-c")]
OptionalCalibrationPath = Annotated[Path | None, Arg(short="-c")]


MAX_COORDINATE_M = 1e8
"""Largest coordinate that an option accepts [m]: more than twice around the Earth."""


def at_least(smallest: int, option: str, value: int | None) -> None:
    """Refuse a count below `smallest`."""
    if value is not None and value < smallest:
        raise OptionError(f"{option}: found {value}, expected {smallest} or more.")


def positive(option: str, value: float) -> None:
    """Refuse a length that is not above 0."""
    if not (math.isfinite(value) and value > 0):
        raise OptionError(f"{option}: found {value:g}, expected a number above 0.")


def range_limits(smallest: str, low: float, largest: str, high: float) -> None:
    """Refuse range limits [m] between which there is no distance."""
    for option, value in ((smallest, low), (largest, high)):
        if not (math.isfinite(value) and value >= 0):
            raise OptionError(f"{option}: found {value:g}, expected a distance in metres.")
    if low >= high:
        raise OptionError(f"{largest}: found {high:g}, expected more than {smallest}, which is {low:g}.")


def coordinates(option: str, values: tuple[float, ...]) -> None:
    """Refuse coordinates [m] that are not finite or further away than any scan or survey grid reaches."""
    if not all(math.isfinite(value) and abs(value) <= MAX_COORDINATE_M for value in values):
        found = " ".join(f"{value:g}" for value in values)
        raise OptionError(f"{option}: found {found}, expected metres within {MAX_COORDINATE_M:g} of 0.")


class Place(NamedTuple):
    """A file or folder that a verb reads or writes."""

    role: str
    """The option or argument that names it, or another subject for the message."""
    path: Path

    def __str__(self) -> str:
        return f"{self.role} {self.path}"

    @property
    def is_capture(self) -> bool:
        """Whether all files of a capture in it are meant too."""
        return os.path.isdir(self.path)


Paths = Mapping[str, Path | str | Iterable[Path] | None]
"""Files and folders by the option or argument that names them. None, and "-" for standard output, are none."""
_reads: list[Path] = []


def _places(paths: Paths) -> list[Place]:
    """All places; of a calibration also the file of its observations."""
    found = []
    for role, value in paths.items():
        for path in [value] if isinstance(value, Path | str) else value or ():
            if path == "-":
                continue
            found.append(Place(role, Path(path)))
            if found[-1].path.suffix.lower() == ".json" and role != "--json":
                beside = calibration_files.observations_path(Path(path))
                found.append(Place(f"the observations of {role},", beside))
    return found


def check_paths(reads: Paths, writes: Paths = MappingProxyType({}), *, kept: Paths = MappingProxyType({})) -> None:
    """Refuse an output that is an input, or another output, also under another name or as a link; and a place for the
    JSON that cannot be written.

    Args:
        reads: All files that the verb reads.
        writes: All files that it writes; in the folder of a capture that it reads, only files that are not of it.
        kept: Files of the capture itself that the verb writes.

    Raises:
        JaxscanError: If the JSON cannot be written.
        OptionError: With both names; nothing is changed. Also if a name is none that a disk can have, or if an output
            would follow a link in the folder of a capture: whoever made the capture chose where it leads.
    """
    inputs, own = _places(reads), _places(kept)
    _reads[:] = [place.path for place in inputs]
    known = [(place, _identity(place)) for place in (*inputs, *own)]
    captures = [place for place in inputs if place.is_capture]
    for place in _places({**writes, "--json": json_target()}):
        identity = _identity(place)
        for other, theirs in known:
            if identity & theirs:
                loss = "which would be lost" if other in inputs else "and one of the two would be lost"
                raise OptionError(f"{place}: is the same file as {other}, {loss}; choose another name.")
        for capture in captures:
            if _follows_a_link_in(os.path.realpath(capture.path), place.path, set()):
                raise OptionError(
                    f"{place}: is a link in the folder of a capture, which may lead anywhere; choose another name."
                )
            if _is_of_capture(place.path, identity, capture.path):
                raise OptionError(f"{place}: is a file of the capture {capture}, which would be lost; choose another.")
        known.append((place, identity))
    for place in own:
        for other in inputs:
            if _identity(place) & _identity(other):
                raise OptionError(f"{other}: is the file in which {place.role} are kept; move it to another folder.")
    if json_target() not in (None, "-"):
        disk.check_writable(str(json_target()))


def inputs_in_words() -> str:
    """The inputs of the verb that checked its paths last."""
    return ", ".join(dict.fromkeys(map(str, _reads))) or "the input"


def _identity(place: Place) -> set[object]:
    """Marks that two names of one file share: where links lead, and, for a file that exists, its number on the disk."""
    try:
        found: set[object] = {os.path.realpath(place.path)}
        status = os.stat(place.path)
    except ValueError as problem:
        raise OptionError(f"{place}: is no name that a file can have: {problem}.") from problem
    except OSError as problem:
        if problem.errno == errno.ENAMETOOLONG:
            raise OptionError(f"{place}: the name is longer than the disk allows.") from problem
        if is_address(place.path):
            raise OptionError(f"{place}: is an address, expected a path on a disk; {COPY_FIRST}.") from problem
        return found
    return found | {(status.st_dev, status.st_ino)}


def _follows_a_link_in(folder: str, path: Path, seen: set[Path]) -> bool:
    """Whether a link that lies in a folder is followed on the way to a file, also by way of links elsewhere."""
    for part in (path, *path.parents):
        if part in seen or not os.path.islink(part):
            continue
        seen.add(part)
        if Path(os.path.realpath(part.parent)).is_relative_to(folder):
            return True
        if _follows_a_link_in(folder, part.parent / os.readlink(part), seen):
            return True
    return False


def _is_of_capture(path: Path, identity: set[object], capture: Path) -> bool:
    """Whether a file that is to be written is one of a capture's own."""
    inside = Path(os.path.realpath(path)).is_relative_to(os.path.realpath(capture))
    # Reading the journal of a large capture takes seconds; a file elsewhere is one of it only by a second name.
    if not inside and not (path.exists() and path.stat().st_nlink > 1):
        return False
    files = [capture / name for name in (capture_files.HEADER_NAME, capture_files.JOURNAL_NAME)]
    files.append(capture / capture_files.CACHE_NAME)
    if (capture / capture_files.JOURNAL_NAME).is_file():
        records = capture_files.read_texts(capture).records
        files += [capture / image.path for record in records for image in (*record.on, *record.off)]
    return any(identity & _identity(Place("", file)) for file in files)


def need_pages(what: str, extra: str) -> None:
    """Check that pages can be served; `what` begins the message, which names the extra that brings what is missing."""
    if find_spec("aiohttp") is None:
        raise DependencyError(f"{what} needs aiohttp; type: pip install 'jaxscan[{extra}]'")
