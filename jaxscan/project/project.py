"""A project with its captures found: whose calibration belongs to each."""

import glob
import os
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path

from jaxscan.errors import ConfigError
from jaxscan.files.capture import HEADER_NAME, open_capture
from jaxscan.project.config import Name, ProjectFile, RigTable, SettingsTable, load_project_file


MOST_CAPTURES = 100_000


@dataclass(frozen=True)
class ProjectCapture:
    """A sweep of the project."""

    name: Name
    """That of its folder: the key of its products."""
    path: Path
    rig: RigTable
    settings: SettingsTable


@dataclass(frozen=True)
class Project:
    """What there is, and what is wanted of it."""

    file: Path
    wanted: ProjectFile
    captures: tuple[ProjectCapture, ...]
    """In the order of their names."""

    @property
    def output(self) -> Path:
        """The folder of the products."""
        return self.file.parent / self.wanted.project.output


def load_project(path: str | Path) -> Project:
    """A project, its patterns followed. Captures are looked at only where two calibrations of a rig need their day.

    Raises:
        ConfigError: If the file is none, a pattern finds nothing, two captures have one name, or not exactly one
            calibration fits a capture.
    """
    file = Path(path).absolute()
    wanted = load_project_file(file)
    found: dict[str, ProjectCapture] = {}
    for table in wanted.captures:
        folders = _folders(file.parent, table.pattern)
        if not folders:
            raise ConfigError(f'{path}: captures: the pattern "{table.pattern}" finds no capture.')
        for folder in folders:
            before = found.get(folder.name)
            if before is not None:
                raise ConfigError(
                    f'{path}: captures: "{folder.name}" is found twice, as {before.path} and as {folder}; names are the '
                    "keys of products, so each must be another."
                )
            rig = _rig_of(path, folder, [rig for rig in wanted.rig if rig.name == table.rig])
            found[folder.name] = ProjectCapture(folder.name, folder, rig, table.settings)
    for group in wanted.station_group:
        missing = next((name for name in group.captures if name not in found), None)
        if missing is not None:
            raise ConfigError(f'{path}: station_group "{group.name}": there is no capture "{missing}".')
    return Project(file, wanted, tuple(found[name] for name in sorted(found)))


def _folders(home: Path, pattern: str) -> list[Path]:
    """The captures that a pattern finds."""
    places = sorted(glob.glob(pattern, root_dir=home))
    if len(places) > MOST_CAPTURES:
        raise ConfigError(f'the pattern "{pattern}" finds {len(places)} places, expected at most {MOST_CAPTURES}.')
    return [home / place for place in places if os.path.isfile(home / place / HEADER_NAME)]


def _rig_of(path: str | Path, folder: Path, rigs: list[RigTable]) -> RigTable:
    """The rig's table that is valid for a capture."""
    if len(rigs) == 1 and rigs[0].first is None and rigs[0].last is None:
        return rigs[0]
    day = _day_of(folder)
    fits = [rig for rig in rigs if (rig.first or date.min) <= day <= (rig.last or date.max)]
    if len(fits) != 1:
        count = "no calibration fits" if not fits else f"{len(fits)} calibrations fit"
        raise ConfigError(
            f'{path}: rig "{rigs[0].name}": {count} {folder.name} of {day}; set `first` and `last` so that one does.'
        )
    return fits[0]


def _day_of(folder: Path) -> date:
    """The day on which a capture was begun."""
    started = open_capture(folder, compare=False).header.acquisition.get("started")
    try:
        return datetime.fromisoformat(started).date() if isinstance(started, str) else _unknown(folder)
    except ValueError:
        return _unknown(folder)


def _unknown(folder: Path) -> date:
    raise ConfigError(f"{folder}: does not say when it was taken, and its rig has calibrations for parts of time.")
