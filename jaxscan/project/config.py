"""`project.toml`: which captures there are, whose calibration belongs to them, and what is wanted of them."""

from datetime import date
from pathlib import Path
from typing import Annotated, Literal, get_args

import pydantic

from jaxscan.files.disk import FileModel, Integer, load_toml


Product = Literal["cloud", "mesh", "plan", "panorama", "report"]
Format = Literal["ply", "npz", "e57", "las", "laz", "pcd", "xyz", "ptx"]
PRODUCTS: tuple[Product, ...] = get_args(Product)
MOST_PARTS = 10_000
"""Rigs, patterns and groups of a project."""
Name = Annotated[str, pydantic.Strict(), pydantic.Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
_Place = Annotated[str, pydantic.Strict(), pydantic.Field(min_length=1, max_length=1000)]


class SettingsTable(FileModel):
    """How captures are reconstructed; what is not named is as `jaxscan reconstruct` has it."""

    every: Annotated[Integer, pydantic.Field(ge=1, le=100_000)] = 1
    """Only every n-th record."""
    colour: Literal["photographs", "stripe"] = "photographs"
    smooth: bool = True


class ProjectTable(FileModel):
    """What is wanted."""

    name: Name
    output: _Place = "products"
    """Folder of the products, from the project's own."""
    catalogue: Annotated[str, pydantic.Strict(), pydantic.Field(max_length=1000)] = ""
    """Address of a database as SQLAlchemy knows them; "" for a file in the folder of the products."""
    products: Annotated[tuple[Product, ...], pydantic.Field(min_length=1, max_length=5)] = ("cloud",)
    formats: Annotated[tuple[Format, ...], pydantic.Field(min_length=1, max_length=8)] = ("ply",)
    """Of clouds."""


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

    @pydantic.model_validator(mode="after")
    def _one_source(self) -> "RigTable":
        if (self.calibration is None) == (not self.boards):
            raise ValueError(f"the rig {self.name!r} needs a calibration or captures of boards, one of the two")
        if self.first is not None and self.last is not None and self.last < self.first:
            raise ValueError(f"the rig {self.name!r} ends on {self.last}, before it begins on {self.first}")
        return self


class CapturesTable(FileModel):
    """Captures of one rig."""

    pattern: _Place
    """A folder, or a pattern of folders, from the project's own."""
    rig: Name
    settings: SettingsTable = SettingsTable()


class GroupTable(FileModel):
    """Stations that belong together."""

    name: Name
    captures: Annotated[tuple[Name, ...], pydantic.Field(min_length=2, max_length=200)]
    merged: Annotated[tuple[Literal["e57", "ply", "plan"], ...], pydantic.Field(min_length=1)] = ("e57",)


class ProjectFile(FileModel):
    """The file."""

    project: ProjectTable
    rig: Annotated[tuple[RigTable, ...], pydantic.Field(min_length=1, max_length=MOST_PARTS)]
    captures: Annotated[tuple[CapturesTable, ...], pydantic.Field(min_length=1, max_length=MOST_PARTS)]
    station_group: Annotated[tuple[GroupTable, ...], pydantic.Field(max_length=MOST_PARTS)] = ()

    @pydantic.model_validator(mode="after")
    def _names_are_known(self) -> "ProjectFile":
        rigs = {rig.name for rig in self.rig}
        unknown = next((one.rig for one in self.captures if one.rig not in rigs), None)
        if unknown is not None:
            raise ValueError(f"captures name the rig {unknown!r}, known are {', '.join(sorted(rigs))}")
        names = [group.name for group in self.station_group]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"two groups have the name {twice!r}, expected different names")
        return self


def load_project_file(path: str | Path) -> ProjectFile:
    """A project as its file has it; nothing else is looked at.

    Raises:
        ConfigError: One line: the file, the line or the key, the value found and the values allowed.
    """
    return load_toml(path, ProjectFile)
