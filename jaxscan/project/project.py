"""A project with its captures found: whose calibration belongs to each."""

import glob
import os
import re
import unicodedata
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path, PurePosixPath

from jaxscan.errors import ConfigError
from jaxscan.files.capture import HEADER_NAME, CaptureHeader
from jaxscan.files.remote import find_captures, is_remote
from jaxscan.project.config import (
    Format,
    GroupTable,
    Name,
    Product,
    ProjectFile,
    RigTable,
    SettingsTable,
    load_project_file,
)
from jaxscan.project.fitting import fitting_products, header_of


MOST_CAPTURES = 100_000


@dataclass(frozen=True)
class ProjectCapture:
    """A sweep of the project."""

    name: Name
    """Made of that of its folder: the key of its products."""
    address: str
    """Its folder, or where it is on object storage."""
    rig: RigTable
    settings: SettingsTable
    products: tuple[Product, ...]
    """Those that are wanted and can be made of it."""
    formats: tuple[Format, ...]
    """Of its cloud."""


@dataclass(frozen=True)
class Project:
    """The captures that were found, and the products that are wanted of them."""

    file: Path
    wanted: ProjectFile
    captures: tuple[ProjectCapture, ...]
    """In the order of their names."""
    notes: tuple[str, ...] = ()
    """Sentences on products that are left out."""

    @property
    def output(self) -> Path:
        """The folder of the products."""
        return self.file.parent / self.wanted.project.output


def load_project(path: str | Path) -> Project:
    """A project, its patterns followed.

    Captures are looked at only where calibrations of a rig need their day, and on this disk where a product that is
    wanted cannot be made of every capture.

    Raises:
        ConfigError: If the file is none, a pattern finds nothing, two captures have one name, not exactly one
            calibration fits a capture, a group is not of one rig, or a table asks for a product that none of its
            captures can have.
    """
    file = Path(path).absolute()
    wanted = load_project_file(file)
    if is_remote(wanted.project.output):
        raise ConfigError(f"{path}: output: found {wanted.project.output}, expected a folder that all workers reach.")
    rigs = defaultdict(list)
    for rig in wanted.rig:
        rigs[rig.name].append(rig)
    found: dict[str, ProjectCapture] = {}
    notes, headers = list[str](), dict[str, CaptureHeader]()
    boards = {_place(file.parent, one) for rig in wanted.rig for one in rig.boards}
    for table in wanted.captures:
        addresses = [one for one in _captures(file.parent, table.pattern) if _place(file.parent, one) not in boards]
        if not addresses:
            raise ConfigError(f'{path}: captures: the pattern "{table.pattern}" finds no capture.')
        own: dict[Name, str] = {}
        for address in addresses:
            name = _name_of(path, address, table.pattern)
            other = own.get(name) or (found[name].address if name in found else None)
            if other is not None:
                raise ConfigError(
                    f'{path}: captures: "{name}" is found twice, as {other} and as {address}; names are the keys of '
                    "products: rename a folder, or let the pattern have its * where the folders differ, as in */sweep."
                )
            own[name] = address
        of_rig = {name: _rig_of(path, own[name], rigs[table.rig], headers) for name in own}
        fitting = fitting_products(path, table, wanted.project, own, headers)
        formats = wanted.project.formats if table.formats is None else table.formats
        for name, products in fitting.products.items():
            found[name] = ProjectCapture(name, own[name], of_rig[name], table.settings, products, formats)
        notes.extend(fitting.notes)
    for group in wanted.group:
        _check_group(path, group, found)
    project = Project(file, wanted, tuple(found[name] for name in sorted(found)), tuple(notes))
    _check_output(path, project)
    return project


def _check_output(path: str | Path, project: Project) -> None:
    """Captures stay as they are: nothing is written into their folders."""
    output = Path(os.path.realpath(project.output))
    inside = {output, *output.parents}
    for capture in project.captures:
        if not is_remote(capture.address) and Path(os.path.realpath(capture.address)) in inside:
            raise ConfigError(
                f"{path}: output: {project.wanted.project.output} is in the capture {capture.name}, expected a folder "
                "of its own."
            )


def _captures(home: Path, pattern: str) -> Sequence[str]:
    """The addresses of the captures that a pattern finds."""
    if is_remote(pattern):
        return find_captures(pattern)
    places = sorted(glob.glob(pattern, root_dir=home))
    if len(places) > MOST_CAPTURES:
        raise ConfigError(f'the pattern "{pattern}" finds {len(places)} places, expected at most {MOST_CAPTURES}.')
    return [str(home / place) for place in places if os.path.isfile(home / place / HEADER_NAME)]


def _place(home: Path, address: str) -> str:
    """The same text for the same place."""
    return address if is_remote(address) else os.path.realpath(home / address)


def _name_of(path: str | Path, address: str, pattern: str) -> Name:
    """The name of a capture: the part of its path that the pattern leaves open, else the last one.

    It becomes the name of files, so accents are dropped, and all but plain letters, digits and ._- becomes -.
    """
    # A letter in brackets stands for itself.
    wild = [bool(set(re.sub(r"\[[*?[]\]", "", part)) & set("*?[")) for part in pattern.rstrip("/").split("/")]
    parts = address.rstrip("/").split("/")[-len(wild) :]
    opened = range(wild.index(True), len(wild) - wild[::-1].index(True)) if any(wild) else [-1]
    folded = unicodedata.normalize("NFKD", "-".join(parts[k] for k in opened)).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", folded).lstrip("._-")[:64].rstrip("-")
    if not name:
        raise ConfigError(
            f"{path}: captures: the name of {address} becomes that of its products, and has no letter from a to z and "
            "no digit; rename the folder."
        )
    return name


def _rig_of(path: str | Path, address: str, rigs: Sequence[RigTable], headers: dict[str, CaptureHeader]) -> RigTable:
    """The rig's table that is valid for a capture; a header that is read for it is added to `headers`."""
    if len(rigs) == 1 and rigs[0].first is None and rigs[0].last is None:
        return rigs[0]
    headers[address] = header_of(address)
    day = _day_of(address, headers[address])
    fits = [rig for rig in rigs if (rig.first or date.min) <= day <= (rig.last or date.max)]
    if len(fits) != 1:
        count = "no calibration fits" if not fits else f"{len(fits)} calibrations fit"
        name = PurePosixPath(address).name
        raise ConfigError(
            f'{path}: rig "{rigs[0].name}": {count} {name} of {day}; set `first` and `last` so that one does.'
        )
    return fits[0]


def _day_of(address: str, header: CaptureHeader) -> date:
    """The day on which a capture was begun."""
    started = header.acquisition.get("started")
    try:
        return datetime.fromisoformat(started).date() if isinstance(started, str) else _unknown(address)
    except ValueError:
        return _unknown(address)


def _unknown(address: str) -> date:
    raise ConfigError(f"{address}: does not say when it was taken, and its rig has calibrations for parts of time.")


def _check_group(path: str | Path, group: GroupTable, found: dict[str, ProjectCapture]) -> None:
    missing = next((name for name in group.captures if name not in found), None)
    if missing is not None:
        raise ConfigError(f'{path}: group "{group.name}": there is no capture "{missing}".')
    rigs = {found[name].rig for name in group.captures}
    if len(rigs) > 1:
        names = " and ".join(sorted(rig.name for rig in rigs))
        raise ConfigError(
            f'{path}: group "{group.name}": its captures are of several calibrations ({names}), expected one.'
        )
