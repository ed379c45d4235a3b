"""The plan of an import: which images make which record."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.capture import BoardTable
from jaxscan.files.importing.angles import Place, by_file, by_step
from jaxscan.files.importing.listing import Matched
from jaxscan.files.importing.pairing import Columns, pair
from jaxscan.geometry.motions import Carries


_MOST = 1e5
"""Largest angle [deg] or position [mm] at the end of a sweep."""


@dataclass(frozen=True)
class ImportRequest:
    """The wishes of a user, as far as they decide on records; everything may be left open."""

    on: tuple[str, ...] = ()
    """Patterns of laser-on images: one, one for each laser, or one for each exposure."""
    off: tuple[str, ...] = ()
    boards: tuple[str, ...] = ()
    """Patterns of images of a board without laser."""
    board: BoardTable | None = None
    """With a board the capture is one of a calibration."""
    carries: Carries | None = None
    """The motion: it says whether there are angles, positions, or neither."""
    step: float | None = None
    """Of the table [deg], or of a linear stage [mm]."""
    places: Path | None = None
    """File of angles [deg] or positions [mm]."""
    exposures_ms: tuple[float, ...] = ()
    lasers: tuple[str, ...] = ()
    """Names of the lasers."""
    every: int = 1
    """Of a video, every so many frames."""


class Source(NamedTuple):
    """An image file, or a frame of a video."""

    name: str
    frame: int | None = None

    def __str__(self) -> str:
        return self.name if self.frame is None else f"{self.name}#{self.frame}"


class PlannedRecord(NamedTuple):
    """One record of the capture to be written."""

    on: tuple[Source, ...]
    """One, or one for each exposure; empty without a laser."""
    off: tuple[Source, ...]
    place: Place
    laser: str | None
    """Name of the laser that is lit, where there are several."""


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
    """How names, pairs and angles are understood, a sentence each."""
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
        folder: The stranger's folder.
        roles: Its images.
        request: The wishes of the user.

    Raises:
        OptionError: If an option is missing or does not fit the images.
        CaptureError: If images have no partner; with their names.
    """
    exposures = tuple(ms / 1000 for ms in request.exposures_ms)
    columns = pair(roles.on, roles.off, len(exposures))
    said = [*roles.said, *columns.said]
    first = [step[0] for step in columns.on[0][1]] if columns.on else list(roles.boards)
    names = [str(Source(one.name, one.frame)) for one in first]
    places, sentence = _places([one.key for one in first], names, roles.step_deg, request)
    said += [f"{'positions' if request.carries == 'linear' else 'angles'}: {sentence}"] if sentence else []
    records = _with_laser(columns, places, several=len({name for name, _ in columns.on}) > 1)
    if roles.boards and columns.on:
        # Boards beside pairs: of other poses, so they take no part in the turning.
        records += [PlannedRecord((), (Source(one.name, one.frame),), Place(None), None) for one in roles.boards]
    elif roles.boards:
        records = [
            PlannedRecord((), (Source(one.name, one.frame),), place, None)
            for one, place in zip(roles.boards, places, strict=True)
        ]
    rows = [Row(f"laser on{f' ({name})' if name else ''}", _sources(steps)) for name, steps in columns.on]
    rows += [Row("laser off", _sources(columns.off))] if columns.off else []
    rows += [Row("board, no laser", tuple(Source(one.name, one.frame) for one in roles.boards))] if roles.boards else []
    names_of_lasers = tuple(dict.fromkeys(name or "laser" for name, _ in columns.on))
    return ImportPlan(folder, tuple(records), tuple(rows), tuple(said), names_of_lasers, request, exposures)


def _sources(steps: Sequence[Sequence[Matched]]) -> tuple[Source, ...]:
    return tuple(Source(one.name, one.frame) for step in steps for one in step)


def _with_laser(columns: Columns, places: Sequence[Place], *, several: bool) -> list[PlannedRecord]:
    made = []
    for at, place in enumerate(places if columns.on else []):
        off = tuple(Source(one.name, one.frame) for one in columns.off[at]) if columns.off else ()
        for name, steps in columns.on:
            lit = tuple(Source(one.name, one.frame) for one in steps[at])
            made.append(PlannedRecord(lit, off, place, name if several else None))
    return made


def _places(
    keys: Sequence[tuple[int | str, ...]], names: Sequence[str], known: float | None, request: ImportRequest
) -> tuple[list[Place], str | None]:
    """The table's angle, or the position of the stage, in every record."""
    words = _MILLIMETRES if request.carries == "linear" else _DEGREES
    step = known if request.step is None else request.step
    if request.step is not None and request.places is not None:
        raise OptionError(f"{words.step} and {words.file}: found both, expected one of them.")
    if step is not None and not abs(step) * max(1, len(keys)) <= _MOST:
        raise OptionError(f"{words.step}: found {step:g}, expected {words.between}.")
    if request.places is not None:
        places, said = by_file(request.places, names)
    elif step is not None:
        places, said = by_step(keys, step, words.unit)
        if request.board is not None:
            places = [place._replace(placement=0) for place in places]
            said += "; the board stood still meanwhile"
    elif request.board is not None:
        return [Place(None) for _ in keys], "unknown; every image shows the board in another pose"
    elif request.carries == "nothing":
        return [Place(None) for _ in keys], None
    elif len(keys) == 1:
        return [Place(0.0)], None
    else:
        turn = "" if words is _MILLIMETRES else f", which is {360 / len(keys):.4g} if they are one whole turn"
        raise OptionError(
            f"{words.step}: is needed for a sweep of {len(keys)} steps: {words.between}{turn}; or {words.file} FILE "
            "with a line for each image."
        )
    if request.board is None and any(place.value is None for place in places):
        raise CaptureError(f"{request.places}: a place is unknown, and a sweep needs that of every image.")
    return places, said


class _Words(NamedTuple):
    """The words for places of a motion."""

    step: str
    file: str
    between: str
    unit: str


_DEGREES = _Words("--step-deg", "--angles", "the table's angle between two images", "degrees")
_MILLIMETRES = _Words("--step-mm", "--positions", "the way of the stage between two images", "mm")
