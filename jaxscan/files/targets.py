"""Targets with known coordinates: a TOML file that a person writes."""

from pathlib import Path
from typing import Annotated

import numpy as np
import pydantic

from jaxscan.files.disk import FileModel, Number, load_toml


MAX_TARGETS = 1000
_Name = Annotated[str, pydantic.Strict(), pydantic.Field(min_length=1, max_length=100)]
_Seen = Annotated[Number, pydantic.Field(ge=-10_000, le=10_000)]
# National grids.
_Known = Annotated[Number, pydantic.Field(ge=-1e8, le=1e8)]


class TargetTable(FileModel):
    """A target."""

    name: _Name
    scanner: tuple[_Seen, _Seen, _Seen]
    """Its place in the frame of the cloud [m]."""
    site: tuple[_Known, _Known, _Known]
    """Its place in the frame that is wanted [m]."""


class TargetsTable(FileModel):
    """The file."""

    target: Annotated[tuple[TargetTable, ...], pydantic.Field(min_length=1, max_length=MAX_TARGETS)]

    @pydantic.model_validator(mode="after")
    def _each_once(self) -> "TargetsTable":
        names = [one.name for one in self.target]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"two targets have the name {twice!r}, expected different names")
        return self


def load_targets(path: str | Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Targets with their coordinates in the frame of a cloud and in another frame.

    Args:
        path: A TOML file; see docs/formats.md.

    Returns:
        names: The names of the targets.
        scanner, site: Their coordinates [m], float64 [targets, 3].

    Raises:
        ConfigError: One line: the file, the line or the key, the value found and the values allowed.
    """
    targets = load_toml(path, TargetsTable).target
    scanner, site = (np.array([getattr(one, frame) for one in targets], np.float64) for frame in ("scanner", "site"))
    return [one.name for one in targets], scanner, site
