"""Known lengths of a room, and where the rig stood: a TOML file that a person writes."""

from pathlib import Path
from typing import Annotated

import numpy as np
import pydantic

from jaxscan.files.disk import FileModel, Number, load_toml
from jaxscan.recalibration import Given, MeasuredLength, Place


MAX_ENTRIES = 1000

_Coordinate = Annotated[Number, pydantic.Field(ge=-1000, le=1000)]
_Point = tuple[_Coordinate, _Coordinate, _Coordinate]
_Target = Annotated[str, pydantic.Strict(), pydantic.Field(min_length=1, max_length=100)]


class LengthTable(FileModel):
    """A measured length."""

    metres: Annotated[Number, pydantic.Field(gt=0, le=1000)]
    sigma_mm: Annotated[Number, pydantic.Field(ge=0.001, le=1000)]
    a: _Point | _Target
    """Place of one end: a point on a wall [m], or the name of a target."""
    b: _Point | _Target

    @pydantic.field_validator("a", "b", mode="plain")
    @classmethod
    def _place(cls, value: object) -> _Point | _Target:
        if isinstance(value, str):
            if 0 < len(value) <= 100 and value.isprintable():
                return value
            raise ValueError("expected the name of a target of at most 100 letters, or three coordinates in metres")
        numbers = value if isinstance(value, list | tuple) else ()
        real = [number for number in numbers if isinstance(number, int | float) and not isinstance(number, bool)]
        if len(numbers) != 3 or len(real) != 3 or not all(abs(number) <= 1000 for number in real):
            raise ValueError("expected three coordinates in metres within 1000 of 0, or the name of a target")
        return (float(real[0]), float(real[1]), float(real[2]))

    @pydantic.model_validator(mode="after")
    def _two_places(self) -> "LengthTable":
        if self.a == self.b:
            raise ValueError("a and b are the same place, expected the two ends of a length")
        if isinstance(self.a, str) != isinstance(self.b, str):
            raise ValueError("one of a and b is a target and the other a point, expected two of one kind")
        return self


class StationTable(FileModel):
    """Where the rig stood for the second sweep, the third, and so on."""

    at: _Point
    """Its place in the frame of the first station [m], good to half a metre."""
    yaw_deg: Annotated[Number, pydantic.Field(ge=-360, le=360)]
    """Its turn about the axis, from the first station's x towards its y, good to ten degrees."""


class KnownTable(FileModel):
    """The file."""

    length: Annotated[tuple[LengthTable, ...], pydantic.Field(max_length=MAX_ENTRIES)] = ()
    station: Annotated[tuple[StationTable, ...], pydantic.Field(max_length=MAX_ENTRIES)] = ()

    @pydantic.model_validator(mode="after")
    def _says_something(self) -> "KnownTable":
        if not self.length and not self.station:
            raise ValueError("found nothing, expected [[length]] or [[station]]")
        return self


def load_known_room(path: str | Path) -> Given:
    """Known lengths of a room, and first poses of stations.

    Args:
        path: A TOML file; see docs/formats.md.

    Raises:
        ConfigError: One line: the file, the line or the key, the value found and the values allowed.
    """
    table = load_toml(path, KnownTable)
    lengths = tuple(
        MeasuredLength(one.metres, 1e-3 * one.sigma_mm, _place(one.a), _place(one.b), f"length {number}")
        for number, one in enumerate(table.length, 1)
    )
    stations = np.stack([np.eye(4), *map(_pose, table.station)]) if table.station else None
    return Given(stations=stations, lengths=lengths)


def _pose(station: StationTable) -> np.ndarray:
    """T_room_scanner [4, 4] of an upright rig."""
    yaw, pose = np.radians(station.yaw_deg), np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = station.at
    return pose


def _place(value: _Point | _Target) -> Place:
    return value if isinstance(value, str) else np.array(value, np.float64)
