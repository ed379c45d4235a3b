"""The plan of an import: which images make which record, at which angle, position or pose."""

import io
import itertools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.capture import BoardTable
from jaxscan.files.disk import MEGABYTE, read_bounded
from jaxscan.files.importing.sources import Matched, Source
from jaxscan.geometry import MOTIONS, Carries, exponential, from_quaternion, is_pose, nearest_rotation, rigid
from jaxscan.geometry.motion_kinds import PoseFormat, PoseUnit


# Poses of a hand as robots and trackers write them: one line of numbers each.

_ROUNDED = 0.01
"""Numbers of three digits make rotations and quaternions that are off by this."""


class _Layout(NamedTuple):
    """What the numbers of a line are."""

    counts: tuple[int, ...]
    numbers: str
    read: Callable[[np.ndarray], np.ndarray]
    """A matrix of rotation and place, 3 x 4, not checked."""


def _of_quaternion(numbers: np.ndarray) -> np.ndarray:
    """The matrix of x y z and a quaternion, w first."""
    length = np.linalg.norm(numbers[3:])
    # A quaternion of another length makes no rotation, and is refused with those.
    turn = from_quaternion(numbers[3:]) if length > 0 else np.zeros((3, 3))
    return np.column_stack([turn if abs(length - 1) < _ROUNDED else length * turn, numbers[:3]])


def _of_matrix(numbers: np.ndarray) -> np.ndarray:
    matrix = numbers.reshape(-1, 4)
    if len(matrix) == 3:
        return matrix
    ends = lambda rows: np.abs(rows[3] - [0.0, 0.0, 0.0, 1.0]).max() < _ROUNDED
    # Some programs write column after column: the zeros tell, but for a pose without a translation.
    rows = matrix if ends(matrix) else matrix.T
    return rows[:3] if ends(rows) else np.zeros((3, 4))


def _of_vector(numbers: np.ndarray) -> np.ndarray:
    turn = exponential(np.concatenate([np.zeros(3), numbers[3:]]))[:3, :3]
    return np.column_stack([turn, numbers[:3]])


def _of_angles(numbers: np.ndarray, unit: float = np.radians(1.0)) -> np.ndarray:
    """The matrix of x y z and angles about the fixed axes x, then y, then z."""
    x, y, z = exponential(np.pad(np.diag(unit * numbers[3:]), ((0, 0), (3, 0))))[:, :3, :3]
    return np.column_stack([z @ y @ x, numbers[:3]])


_LAYOUTS: dict[str, _Layout] = {
    # The time before them says nothing here.
    "tum": _Layout((7, 8), "[time] x y z qx qy qz qw", lambda n: _of_quaternion(n[-7:][[0, 1, 2, 6, 3, 4, 5]])),
    "wxyz": _Layout((7,), "x y z qw qx qy qz", _of_quaternion),
    "matrix": _Layout(
        (12, 16), "the rows of a 3 x 4 or 4 x 4 matrix, one after another (or the columns of a 4 x 4 one)", _of_matrix
    ),
    "rotvec": _Layout((6,), "x y z and a rotation vector in radians", _of_vector),
    "rpy": _Layout((6,), "x y z and degrees about the fixed axes x, then y, then z", _of_angles),
    "rpy-rad": _Layout((6,), "x y z and radians about the fixed axes x, then y, then z", lambda n: _of_angles(n, 1.0)),
    "abc": _Layout(
        (6,), "x y z and degrees about z, then the new y, then the new x", lambda n: _of_angles(n[[0, 1, 2, 5, 4, 3]])
    ),
}
_BY_COUNT: dict[int, PoseFormat] = {8: "tum", 12: "matrix", 16: "matrix"}
"""Counts of numbers that tell the format. Seven are a quaternion with w last or first, six have angles of any kind."""


def read_pose(words: Sequence[str], pose_format: PoseFormat | None, unit: PoseUnit) -> tuple[float, ...]:
    """The pose of one line.

    Args:
        words: Its numbers.
        pose_format: Their meaning; None: by their count, where that tells it.
        unit: Unit of lengths.

    Returns:
        T_base_hand: Twelve numbers, row after row [m].

    Raises:
        ValueError: If they are no pose, with the expectation.
    """
    chosen = pose_format or _BY_COUNT.get(len(words))
    if chosen is None:
        fitting = [f"{name} ({one.numbers})" for name, one in _LAYOUTS.items() if len(words) in one.counts]
        raise ValueError(
            f"expected one of --pose-format {', '.join(fitting)}"
            if fitting
            else "expected the 8 numbers of TUM, 12 or 16 of a matrix, or 6 or 7 with --pose-format"
        )
    layout = _LAYOUTS[chosen]
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) not in layout.counts or not np.isfinite(numbers).all():
        counts = " or ".join(map(str, layout.counts))
        raise ValueError(f"expected {counts} numbers, {layout.numbers} (--pose-format {chosen})")
    pose = layout.read(np.clip(numbers, -1e12, 1e12))
    turn, place = pose[:, :3], pose[:, 3] / (1000.0 if unit == "mm" else 1.0)
    proper = np.abs(turn @ turn.T - np.eye(3)).max() < _ROUNDED and np.linalg.det(turn) > 0
    found = np.asarray(rigid(nearest_rotation(turn), place)) if proper else np.zeros((4, 4))
    if not is_pose(found):
        raise ValueError(
            f"found no rigid motion of less than 10 km, expected {layout.numbers} (--pose-format {chosen})"
        )
    return tuple(found[:3].ravel().tolist())


def describe_poses(poses: Sequence[tuple[float, ...]], unit: PoseUnit) -> str:
    """How far they go, so that a wrong unit shows."""
    given = np.reshape(poses, (-1, 3, 4))
    far = float(np.linalg.norm(np.ptp(given[:, :, 3], axis=0)))
    cosine = (np.trace(given[0, :, :3].T @ given[:, :, :3], axis1=1, axis2=2) - 1) / 2
    turned = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).max())
    doubt = "; if that is too far by a thousand: --pose-unit mm" if unit == "m" and far > 10 else ""
    return f"within a box of {far:.4g} m, turned by up to {turned:.3g} degrees{doubt}"


Step = tuple[Matched, ...]
_NAMED = 3


class RecordImages(NamedTuple):
    """Images in the order of the records."""

    on: tuple[tuple[str, tuple[Step, ...]], ...]
    """The name and the steps of each laser; all have the same number of steps."""
    off: tuple[Step, ...]
    """One for each step; empty without laser-off images."""
    said: tuple[str, ...]


def pair(
    on: Sequence[tuple[str, tuple[Matched, ...]]], off: Sequence[tuple[Matched, ...]], exposures: int
) -> RecordImages:
    """Bring all images into the order of the records.

    Args:
        on: Groups of laser-on images, with the names of their lasers; a bracket has a group for each exposure.
        off: Groups of laser-off images: one, or one for each exposure.
        exposures: Number of exposures; 0 where every image stands alone.
    """
    if not on:
        if off:
            raise OptionError("--off: found laser-off images without laser-on images; --on names these, or --boards.")
        return RecordImages((), (), ())
    said: list[str] = []
    if exposures:
        if len(on) != exposures or len(off) not in (0, exposures):
            raise OptionError(
                f"--exposures-ms: found {exposures} exposures, {len(on)} patterns of --on and {len(off)} of --off; "
                "expected a pattern for each exposure."
            )
        lasers = [("", _together([files for _, files in on], "laser-on", said))]
        dark = _together(off, "laser-off", said) if off else ()
    else:
        lasers = [(name, tuple((file,) for file in files)) for name, files in on]
        if len(off) > 1:
            raise OptionError(f"--off: found {len(off)} patterns, expected one, or one for each of --exposures-ms.")
        dark = tuple((file,) for file in off[0]) if off else ()
    first = lasers[0][1]
    ordered = [lasers[0]]
    for name, steps in lasers[1:]:
        ordered.append((name, _follow(first, steps, (lasers[0][0] or "laser on", name or "laser on"), said)))
    if dark:
        # One laser-off image for a whole sweep serves every step.
        if len(dark) == 1 and len(first) > 1:
            said.append(f"{dark[0][0].name} serves as the laser-off image of all {len(first)} steps")
            dark = dark * len(first)
        else:
            dark = _follow(first, dark, ("laser on", "laser off"), said)
    return RecordImages(tuple(ordered), dark, tuple(dict.fromkeys(said)))


def _together(groups: Sequence[tuple[Matched, ...]], kind: str, said: list[str]) -> tuple[Step, ...]:
    """The exposures of every step."""
    first = tuple((file,) for file in groups[0])
    others = [_follow(first, tuple((file,) for file in group), (kind, kind), said) for group in groups[1:]]
    return tuple(tuple(one[0] for one in step) for step in zip(first, *others, strict=True))


def _follow(first: Sequence[Step], steps: Sequence[Step], kinds: tuple[str, str], said: list[str]) -> tuple[Step, ...]:
    """`steps` in the order of `first`: those with the same open part of the name, or else one after the other."""
    wanted, given = [step[0].key for step in first], {step[0].key: step for step in steps}
    if len(given) == len(steps) and len(set(wanted)) == len(wanted) and set(wanted) == set(given):
        said.append(f"{kinds[1]} images belong to {kinds[0]} images by their names")
        return tuple(given[key] for key in wanted)
    shared = len(set(wanted) & set(given))
    if len(first) == len(steps) and 2 * shared <= len(first):
        said.append(f"{kinds[1]} images belong to {kinds[0]} images by their order, for their names do not tell")
        return tuple(steps)
    alone = [step[0].name for step in first if step[0].key not in given]
    spare = [step[0].name for step in steps if step[0].key not in set(wanted)]
    raise CaptureError(
        f"found {len(first)} {kinds[0]} images and {len(steps)} {kinds[1]} images, expected one of each in every step"
        + (f"; without a partner: {_some(alone)}" if 0 < len(alone) < len(first) else "")
        + (f"; too many: {_some(spare)}" if 0 < len(spare) < len(steps) else "")
        + "; name others by --on and --off, or move the surplus away."
    )


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


_MOST_DEG = 1e6


class RecordPlace(NamedTuple):
    """Angle of the table [deg], position of a stage [mm] or pose of a hand in one record, and the board's placement."""

    value: float | None
    placement: int | None = None
    pose: tuple[float, ...] | None = None
    """T_base_hand as twelve numbers, row after row [m]."""


def by_step(keys: Sequence[tuple[int | str, ...]], step: float, unit: str) -> tuple[list[RecordPlace], str]:
    """Places from a step.

    Where one number alone changes from name to name, it counts the steps, so that a missing image shifts no angle;
    otherwise, or where the numbers are times, the images follow one another.

    Args:
        keys: The open part of every name, in natural order.
        step: From one image to the next [deg or mm].
        unit: Its unit, for the sentence.

    Returns:
        The places, and a sentence on them.
    """
    numbers = _counting(keys)
    pace = None if numbers is None else _pace(numbers)
    if numbers is None or pace is None:
        times = "" if numbers is None else f", for the numbers in their names ({numbers[0]} ...) do not count steps"
        steps, said = list(range(len(keys))), "the images follow one another" + times
    else:
        steps = [(number - numbers[0]) // pace for number in numbers]
        missing = steps[-1] + 1 - len(steps)
        if missing > len(steps):
            raise CaptureError(
                f"the numbers in the names go from {numbers[0]} to {numbers[-1]}, and {missing} of {steps[-1] + 1} "
                "steps would be missing: name the images of one scan by --on, or give their places by --angles or "
                "--positions."
            )
        said = "by the numbers in the names" + (f", {missing} of which are missing" if missing else "")
    values = [number * step for number in steps]
    return [RecordPlace(value) for value in values], f"{values[0]:g} to {values[-1]:g} {unit} by {step:g}, {said}"


def _pace(numbers: Sequence[int]) -> int | None:
    """The number of counts from step to step; None where the numbers are times, or count no steps."""
    gaps = [after - before for before, after in itertools.pairwise(numbers)]
    clock = [_seconds(number) for number in numbers]
    if all(second is not None for second in clock):
        lengths = [int(after or 0) - int(before or 0) for before, after in itertools.pairwise(clock)]
        # At the end of a minute a clock, read as a number, leaps by 41 and more; numbers of steps do not.
        if lengths != gaps and max(lengths) - min(lengths) < max(gaps) - min(gaps):
            return None
    pace = math.gcd(*gaps)
    missing = sum(gaps) // pace - len(gaps)
    # Numbers of steps differ by the same amount at least somewhere; times do not.
    return pace if pace in gaps or 2 * missing <= len(numbers) else None


def _seconds(number: int) -> int | None:
    """The second of a day that a number HHMMSS says, perhaps behind a date; None where it says none."""
    rest, second = divmod(number, 100)
    rest, minute = divmod(rest, 100)
    date, hour = divmod(rest, 100)
    if number < 10_000 or second > 59 or minute > 59 or hour > 23 or not (date == 0 or 19_000_101 <= date < 21_000_000):
        return None
    return 86_400 * date + 3600 * hour + 60 * minute + second


def _counting(keys: Sequence[tuple[int | str, ...]]) -> list[int] | None:
    """The one number that rises from key to key while all else stays; None where there is none."""
    if len(keys) < 2 or len({len(key) for key in keys}) != 1:
        return None
    changing = [at for at in range(len(keys[0])) if len({key[at] for key in keys}) > 1]
    if len(changing) != 1:
        return None
    numbers = [key[changing[0]] for key in keys]
    whole = [number for number in numbers if isinstance(number, int)]
    rising = len(whole) == len(numbers) and all(b > a for a, b in itertools.pairwise(whole))
    # So far apart they are times, not steps.
    return whole if rising and whole[-1] - whole[0] < 100 * len(whole) else None


_MOST_WORDS = 20


def by_file(
    path: Path, names: Sequence[str], read: Callable[[Sequence[str]], RecordPlace] | None = None
) -> tuple[list[RecordPlace], str]:
    """Places from a text file: a line for each image, in order or with the image's name first.

    A line holds the angle [deg] or position [mm], "-" where it is not known, and perhaps the number of the board's
    placement, parted by blanks, commas or semicolons; beside semicolons a comma is a decimal point. Lines that begin
    with #, and a first line of words alone, are left out.

    Args:
        names: Names of the images, in natural order.
        read: Reads the words of a line behind the name, where they are no angle or position; what it raises as
            `ValueError` is said with the line.
    """
    text = read_bounded(path, 8 * MEGABYTE, error=CaptureError).decode("utf-8-sig", "replace")
    named, plain, first = dict[str, RecordPlace](), list[RecordPlace](), True
    for number, line in enumerate(io.StringIO(text), 1):
        words = _words(line)
        if not words or words[0].startswith("#") or (first and not any(_is_number(word) for word in words)):
            first = first and not words
            continue
        first = False
        name = None if _is_number(words[0]) else words[0]
        try:
            place = (read or _read_place)(words if name is None else words[1:])
        except ValueError as problem:
            raise CaptureError(f"{path}: line {number}: found {' '.join(words)[:60]!r}, {problem}.") from None
        if name is None:
            plain.append(place)
        else:
            named[name] = place
    if named and plain:
        raise CaptureError(f"{path}: some lines have a name and some have none; expected all or none.")
    if not named:
        if len(plain) != len(names):
            raise CaptureError(f"{path}: found {len(plain)} lines, expected one for each of {len(names)} images.")
        return plain, f"from {path.name}"
    missing = [name for name in names if name not in named and name.rpartition("/")[2] not in named]
    if missing:
        more = f", and for {len(missing) - 1} more images" if len(missing) > 1 else ""
        raise CaptureError(f"{path}: no line for {missing[0]}{more}.")
    return [named.get(name) or named[name.rpartition("/")[2]] for name in names], f"from {path.name}, by name"


def _words(line: str) -> list[str]:
    separators = r"[\s,]+"
    if ";" in line:
        separators, line = r"[\s;]+", line.replace(",", ".")
    return [word.strip("\"'") for word in re.split(separators, line.strip(), maxsplit=_MOST_WORDS) if word]


def _read_place(values: Sequence[str]) -> RecordPlace:
    if not 1 <= len(values) <= 2 or not _is_angle(values[0]) or not all(one.isdecimal() for one in values[1:]):
        raise ValueError("expected a number, or an image's name and a number, and perhaps the number of a placement")
    angle = None if values[0] == "-" else float(values[0])
    return RecordPlace(angle, int(values[1][:9]) if len(values) > 1 else None)


def _is_number(word: str) -> bool:
    """Whether it is no name."""
    try:
        return word == "-" or float(word) is not None
    except ValueError:
        return False


def _is_angle(word: str) -> bool:
    return word == "-" or (_is_number(word) and abs(float(word)) <= _MOST_DEG)


_MOST = 1e5
"""Largest angle [deg] or position [mm] at the end of a sweep."""


@dataclass(frozen=True)
class ImportRequest:
    """The user's choices, as far as they decide on records; everything may be left open."""

    on: tuple[str, ...] = ()
    """Patterns of laser-on images: one, one for each laser, or one for each exposure."""
    off: tuple[str, ...] = ()
    boards: tuple[str, ...] = ()
    board: BoardTable | None = None
    """With a board the capture is one of a calibration."""
    carries: Carries | None = None
    """The motion: it says whether there are angles, positions, or neither."""
    step: float | None = None
    """Step of the table [deg] or of a linear stage [mm] between records."""
    places: Path | None = None
    """File of angles, positions or poses."""
    pose_format: PoseFormat | None = None
    pose_unit: PoseUnit = "m"
    exposures_ms: tuple[float, ...] = ()
    lasers: tuple[str, ...] = ()
    every: int = 1
    """Take every n-th frame of a video."""


class PlannedRecord(NamedTuple):
    """One record of the capture to be written."""

    on: tuple[Source, ...]
    """One, or one for each exposure; empty without a laser."""
    off: tuple[Source, ...]
    place: RecordPlace
    laser: str | None


@dataclass(frozen=True)
class Row:
    """Images of one role, for the table that the user reads."""

    role: str
    files: tuple[Source, ...]


@dataclass(frozen=True)
class ImportPlan:
    """Records, and how they came about."""

    folder: Path
    records: tuple[PlannedRecord, ...]
    rows: tuple[Row, ...]
    said: tuple[str, ...]
    """Explanations of names, pairs and angles, a sentence each."""
    lasers: tuple[str, ...]
    request: ImportRequest
    exposures_s: tuple[float, ...] = ()


class Roles(NamedTuple):
    """The images by their roles, before they are paired."""

    on: tuple[tuple[str, tuple[Matched, ...]], ...]
    """Groups with the name of their laser, or "" where there is one laser."""
    off: tuple[tuple[Matched, ...], ...]
    boards: tuple[Matched, ...]
    step_deg: float | None
    said: tuple[str, ...]


def plan_records(folder: Path, roles: Roles, request: ImportRequest) -> ImportPlan:
    """Pair the images and give them angles.

    Args:
        folder: The folder of the images.
        roles: Its images.
        request: The user's choices.
    """
    exposures = tuple(ms / 1000 for ms in request.exposures_ms)
    columns = pair(roles.on, roles.off, len(exposures))
    said = [*roles.said, *columns.said]
    first = [step[0] for step in columns.on[0][1]] if columns.on else list(roles.boards)
    places, sentence = _places(first, roles.step_deg, request)
    said += [f"{_PLACES[_unit(request)]}: {sentence}"] if sentence else []
    records = _with_laser(columns, places, several=len({name for name, _ in columns.on}) > 1)
    # Boards beside pairs are in other poses, so they take no part in the turning.
    of_boards = [RecordPlace(None)] * len(roles.boards) if columns.on else places
    records += [
        PlannedRecord((), (one.source,), place, None)
        for one, place in zip(roles.boards, of_boards if roles.boards else (), strict=True)
    ]
    rows = [Row(f"laser on{f' ({name})' if name else ''}", _sources(steps)) for name, steps in columns.on]
    rows += [Row("laser off", _sources(columns.off))] if columns.off else []
    rows += [Row("board, no laser", _sources([roles.boards]))] if roles.boards else []
    names_of_lasers = tuple(dict.fromkeys(name or "laser" for name, _ in columns.on))
    return ImportPlan(folder, tuple(records), tuple(rows), tuple(said), names_of_lasers, request, exposures)


def _sources(steps: Sequence[Sequence[Matched]]) -> tuple[Source, ...]:
    return tuple(one.source for step in steps for one in step)


def _with_laser(columns: RecordImages, places: Sequence[RecordPlace], *, several: bool) -> list[PlannedRecord]:
    made = []
    for at, place in enumerate(places if columns.on else []):
        off = _sources(columns.off[at : at + 1])
        for name, steps in columns.on:
            made.append(PlannedRecord(_sources(steps[at : at + 1]), off, place, name if several else None))
    return made


_PLACES = {"m": "positions", "pose": "poses", "rad": "angles", "": "angles"}


def _unit(request: ImportRequest) -> str:
    """Unit of positions."""
    return MOTIONS[request.carries or "scanner"].unit


def _places(
    first: Sequence[Matched], known: float | None, request: ImportRequest
) -> tuple[list[RecordPlace], str | None]:
    """The table's angle, or the position of the stage, in every record, by the first image of each."""
    if _unit(request) == "pose":
        return _poses([str(one.source) for one in first], request)
    keys = [one.key for one in first]
    words = _MILLIMETRES if _unit(request) == "m" else _DEGREES
    step = known if request.step is None else request.step
    if request.step is not None and request.places is not None:
        raise OptionError(f"{words.step} and {words.file}: found both, expected one of them.")
    if step is not None and not abs(step) * max(1, len(keys)) <= _MOST:
        raise OptionError(f"{words.step}: found {step:g}, expected {words.between}.")
    if request.places is not None:
        places, said = by_file(request.places, [str(one.source) for one in first])
    elif step is not None:
        places, said = by_step(keys, step, words.unit)
        if request.board is not None:
            places = [place._replace(placement=0) for place in places]
            said += "; the board stood still meanwhile"
    elif request.board is not None:
        return [RecordPlace(None) for _ in keys], "unknown; every image shows the board in another pose"
    elif request.carries == "nothing":
        return [RecordPlace(None) for _ in keys], None
    elif len(keys) == 1:
        return [RecordPlace(0.0)], None
    else:
        turn = "" if words is _MILLIMETRES else f", which is {360 / len(keys):.4g} if they are one whole turn"
        raise OptionError(
            f"{words.step}: is needed for a sweep of {len(keys)} steps: {words.between}{turn}; or {words.file} FILE "
            "with a line for each image."
        )
    if request.board is None and any(place.value is None for place in places):
        raise CaptureError(f"{request.places}: a place is unknown, and a sweep needs that of every image.")
    if request.board is None and any(place.placement is not None for place in places):
        raise CaptureError(
            f"{request.places}: found two numbers in a line, expected one for each image of a sweep; a comma is a "
            "decimal point only in files with semicolons."
        )
    return places, said


def _poses(names: Sequence[str], request: ImportRequest) -> tuple[list[RecordPlace], str]:
    """The pose of the hand in every record."""
    if request.places is None:
        raise OptionError(f"--poses: is needed: a file with the pose of the hand for each of {len(names)} images.")
    # A hand goes round a board that stands.
    placement = None if request.board is None else 0

    def read(words: Sequence[str]) -> RecordPlace:
        if list(words) == ["-"] and request.board is not None:
            return RecordPlace(None)
        return RecordPlace(None, placement, read_pose(words, request.pose_format, request.pose_unit))

    places, said = by_file(request.places, names, read)
    known = [place.pose for place in places if place.pose is not None]
    if not known:
        raise CaptureError(f"{request.places}: found no pose.")
    said += f", {describe_poses(known, request.pose_unit)}"
    return places, said + ("" if placement is None else "; the board stood still meanwhile")


class _Words(NamedTuple):
    """The words for places of a motion."""

    step: str
    file: str
    between: str
    unit: str


_DEGREES = _Words("--step-deg", "--angles", "the table's angle between two images", "degrees")
_MILLIMETRES = _Words("--step-mm", "--positions", "the way of the stage between two images", "mm")
