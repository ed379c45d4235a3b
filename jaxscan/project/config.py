"""`project.toml`: which captures there are, whose calibration belongs to them, and what is wanted of them."""

from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import pydantic

from jaxscan.files.clouds import FORMATS
from jaxscan.files.disk import COPY_FIRST, FileModel, Integer, is_address, load_toml


Product = Literal["cloud", "measures", "mesh", "plan", "panorama", "report"]
if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[tuple(suffix.removeprefix(".") for suffix in FORMATS)]
Merged = Literal["e57", "plan"]
MOST_PARTS = 10_000
"""Rigs, patterns and groups of a project."""
_Products = Annotated[tuple[Product, ...], pydantic.Field(min_length=1, max_length=6)]
_Formats = Annotated[tuple[Format, ...], pydantic.Field(min_length=1, max_length=len(FORMATS))]
Name = Annotated[str, pydantic.Strict(), pydantic.Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]


def _on_a_disk(place: str) -> str:
    if is_address(place):
        raise ValueError(f"found the address {place:.80}, expected a path; {COPY_FIRST}")
    return place


_Place = Annotated[
    str,
    pydantic.Strict(),
    pydantic.Field(max_length=1000, pattern=r"^[^\x00-\x1f\x7f]+$"),
    pydantic.AfterValidator(_on_a_disk),
]


class SettingsTable(FileModel):
    """Settings of the reconstruction; defaults are those of `jaxscan reconstruct`."""

    every: Annotated[Integer, pydantic.Field(ge=1, le=100_000)] = 1
    """Only every n-th record."""
    colour: Literal["photographs", "stripe"] = "photographs"
    smooth: Literal["edge", "off"] = "edge"
    min_range_m: Annotated[float, pydantic.Field(ge=0.0, le=1000.0)] = 0.05
    """Smallest distance from the camera [m]."""
    max_range_m: Annotated[float, pydantic.Field(gt=0.0, le=1000.0)] = 30.0
    """Largest distance from the camera [m]: stripes are looked for where it allows them."""

    @pydantic.model_validator(mode="after")
    def _limits_in_order(self) -> "SettingsTable":
        if self.min_range_m >= self.max_range_m:
            raise ValueError(
                f"found min_range_m {self.min_range_m:g} and max_range_m {self.max_range_m:g}, expected a "
                "smaller one first"
            )
        return self


class ProjectTable(FileModel):
    """The products that are wanted."""

    name: Name
    output: _Place = "products"
    """Folder of the products, from the project's own."""
    products: _Products = ("cloud", "measures")
    formats: _Formats = ("ply",)
    """Formats of clouds."""


class RigTable(FileModel):
    """A rig, and the calibration that is valid for it in a time."""

    name: Name
    calibration: _Place | None = None
    """A calibration file."""
    boards: Annotated[tuple[_Place, ...], pydantic.Field(max_length=100)] = ()
    """Captures of the board from which it is made."""
    first: date | None = None
    """The first day on which it is valid."""
    last: date | None = None
    recalibrate: Annotated[bool, pydantic.Strict()] = False
    """Whether all its sweeps refine the calibration before clouds are made of them."""

    @pydantic.model_validator(mode="after")
    def _one_source(self) -> "RigTable":
        if (self.calibration is None) == (not self.boards):
            raise ValueError(f'the rig "{self.name}" needs a calibration or captures of boards, one of the two')
        if self.first is not None and self.last is not None and self.last < self.first:
            raise ValueError(f'the rig "{self.name}" ends on {self.last}, before it begins on {self.first}')
        return self


class CapturesTable(FileModel):
    """Captures of one rig."""

    pattern: _Place
    """A folder, or a pattern of folders, from the project's own."""
    rig: Name
    products: _Products | None = None
    """Products of these captures; by default those of the project."""
    formats: _Formats | None = None
    """Formats of their clouds; by default those of the project."""
    settings: SettingsTable = SettingsTable()


class GroupTable(FileModel):
    """Stations that belong together: sweeps of one room from several places, by one rig."""

    name: Name
    captures: Annotated[tuple[Name, ...], pydantic.Field(min_length=2, max_length=200)]
    merged: Annotated[tuple[Merged, ...], pydantic.Field(min_length=1, max_length=2)] = ("e57",)
    known: _Place | None = None
    """Known lengths of the room, and places of the stations where sweeps do not tell them, as of
    `jaxscan recalibrate --known`."""

    @pydantic.model_validator(mode="after")
    def _each_once(self) -> "GroupTable":
        twice = next((name for name in self.captures if self.captures.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f'the group "{self.name}" names the capture "{twice}" twice')
        return self


class ProjectFile(FileModel):
    """The file."""

    project: ProjectTable
    rig: Annotated[tuple[RigTable, ...], pydantic.Field(min_length=1, max_length=MOST_PARTS)]
    captures: Annotated[tuple[CapturesTable, ...], pydantic.Field(min_length=1, max_length=MOST_PARTS)]
    group: Annotated[tuple[GroupTable, ...], pydantic.Field(max_length=MOST_PARTS)] = ()

    @pydantic.model_validator(mode="after")
    def _names_are_known(self) -> "ProjectFile":
        rigs = {rig.name for rig in self.rig}
        unknown = next((one.rig for one in self.captures if one.rig not in rigs), None)
        if unknown is not None:
            raise ValueError(f'captures name the rig "{unknown}", known are {", ".join(sorted(rigs))}')
        names = [group.name for group in self.group]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f'two groups have the name "{twice}", expected different names')
        return self


def load_project_file(path: str | Path) -> ProjectFile:
    """A project as its file has it; nothing else is looked at.

    Raises:
        ConfigError: One line: the file, the line or the key, the value found and the values allowed.
    """
    return load_toml(path, ProjectFile)
