"""A project: its captures found, their products, and the claim on the folder of the products."""

import contextlib
import glob
import json
import os
import re
import shlex
import unicodedata
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path, PurePosixPath
from typing import cast

from jaxscan.errors import ConfigError, JaxscanError
from jaxscan.files.capture import HEADER_NAME, CaptureHeader, parse_header
from jaxscan.files.disk import (
    MEGABYTE,
    FolderLock,
    is_outside,
    make_folder,
    parse_json,
    read_bounded,
    reported,
    write_atomically,
)
from jaxscan.geometry import MOTIONS
from jaxscan.project.config import (
    CapturesTable,
    Format,
    GroupTable,
    Name,
    Product,
    ProjectFile,
    ProjectTable,
    RigTable,
    SettingsTable,
    load_project_file,
)


_MOST_NAMES = 3


def fitting_products(
    table: CapturesTable, wanted: ProjectTable, captures: Mapping[Name, str], headers: dict[str, CaptureHeader]
) -> tuple[dict[Name, tuple[Product, ...]], list[str]]:
    """The products of the captures of one table, without those that cannot be made of them, and a note on each kind.

    Args:
        table: The table of the captures.
        wanted: What the whole project has.
        captures: Addresses, by name.
        headers: Those that were read before, by address; others are read only if something may be left out.
    """
    asked = wanted.products if table.products is None else table.products
    products = dict.fromkeys(captures, asked)
    if not any(kind in motion.unfit for kind in asked for motion in MOTIONS.values()):
        return products, []
    left: dict[tuple[str, tuple[Product, ...]], list[Name]] = defaultdict(list)
    for name, address in captures.items():
        try:
            header = headers[address] if address in headers else header_of(address)
        except JaxscanError:
            # The step that makes its cloud reports this; other captures go on.
            continue
        carries = None if header.turntable is None else header.turntable.carries
        if carries is None:
            continue
        unfit = cast(tuple[Product, ...], MOTIONS[carries].unfit)
        products[name] = tuple(kind for kind in asked if kind not in unfit)
        if gone := tuple(kind for kind in asked if kind in unfit):
            left[carries, gone].append(name)
    notes = []
    for (carries, gone), names in left.items():
        more = [f"{len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else []
        notes.append(
            f'captures "{table.pattern}": no {_and(gone, "or")} of {_and([*names[:_MOST_NAMES], *more])}: '
            f'{HEADER_NAME} says carries = "{carries}", and {MOTIONS[carries].why}.'
        )
    return products, notes


def header_of(address: str) -> CaptureHeader:
    """The header of a capture.

    Raises:
        JaxscanError: If it cannot be read.
    """
    name = f"{address}/{HEADER_NAME}"
    return parse_header(read_bounded(name, MEGABYTE, error=ConfigError), name=name)


def _and(words: Sequence[str], last: str = "and") -> str:
    return f" {last} ".join(filter(None, (", ".join(words[:-1]), words[-1])))


FORMAT = "jaxscan-products/1"
ABOUT, LOCK = "project.json", ".batch.lock"


@dataclass(frozen=True)
class ProjectCapture:
    """A sweep of the project."""

    name: Name
    """Derived from the name of its folder: the key of its products."""
    address: str
    """Its folder."""
    rig: RigTable
    settings: SettingsTable
    products: tuple[Product, ...]
    """The wanted products that can be made of a capture."""
    formats: tuple[Format, ...]
    """Formats of its cloud."""


@dataclass(frozen=True)
class Project:
    """The captures that were found, and the products that are wanted of them."""

    file: Path
    wanted: ProjectFile
    captures: tuple[ProjectCapture, ...]
    """The captures, in the order of their names."""
    notes: tuple[str, ...] = ()
    """Sentences on products that are left out."""

    @property
    def output(self) -> Path:
        """The folder of the products."""
        return self.file.parent / self.wanted.project.output


@contextlib.contextmanager
def claimed(project: Project, named: Path | None = None) -> Iterator[None]:
    """Make the folder of the products this project's, and keep other batches out until the end of `with`.

    Args:
        project: The project, whose file may come from a stranger.
        named: The folder of the products as the user names it: where it lies outside of the project's, the first batch
            needs the user's own word.

    Raises:
        ConfigError: If it belongs to another project, is not the one that was named, lies outside and was not named,
            another batch is at work, or it cannot be written.
    """
    output = project.output
    _check_outside(project, named)
    with reported(f"{output}: cannot be written", error=ConfigError):
        make_folder(output)
    busy, remedy = "another batch is writing here ({})", "wait for it, or end it"
    with FolderLock(output / LOCK, error=ConfigError, busy=busy, remedy=remedy):
        _take_over(project)
        yield


def _is_another(other: str, own: str) -> bool:
    """Whether a file is there and is not this one, by another path."""
    try:
        return not os.path.samefile(other, own)
    except (OSError, ValueError):
        return False


def _check_outside(project: Project, named: Path | None) -> None:
    """Check that a folder outside of the project's is named by the user, or is known to be this project's.

    All links are followed: a link in place of the folder leads outside too.
    """
    output, home = project.output, project.file.parent
    if named is not None:
        if os.path.realpath(named) != os.path.realpath(output):
            raise ConfigError(f"{named}: is not the folder of the products, which {project.file} says is {output}.")
    elif is_outside(output, home) and _owner(project) != str(project.file):
        raise ConfigError(
            f"{project.file}: output: {output} is outside of {home}, where a project writes only what you allow: "
            f"call it once with {shlex.join(['--output', os.path.realpath(output)])}."
        )


def check_owner(project: Project) -> None:
    """Check that the folder of the products is not another project's.

    A project whose folder was moved is still the same; two files that are there are two projects.

    Raises:
        ConfigError: If it belongs to another one.
    """
    other = _owner(project)
    if other is not None and other != str(project.file) and _is_another(other, str(project.file)):
        raise ConfigError(f"{project.output}: holds the products of another project, {other}; choose another `output`.")


def _take_over(project: Project) -> None:
    check_owner(project)
    own = str(project.file)
    if _owner(project) != own:
        about = {"format": FORMAT, "project": project.wanted.project.name, "file": own}
        text = json.dumps(about, indent=2) + "\n"
        write_atomically(project.output / ABOUT, text.encode(), error=ConfigError, links="replace")


def _owner(project: Project) -> str | None:
    path = project.output / ABOUT
    if not os.path.lexists(path):
        return None
    content = read_bounded(path, MEGABYTE, error=ConfigError, links="refuse")
    about = parse_json(content, name=str(path), error=ConfigError)
    other = about.get("file") if isinstance(about, dict) else None
    return other if isinstance(other, str) else None


MOST_CAPTURES = 100_000


def load_project(path: str | Path) -> Project:
    """A project, its patterns followed.

    Captures are looked at only where calibrations of a rig need their day, and where a product that is wanted cannot be
    made of every capture.

    Raises:
        ConfigError: If the file is none, a pattern finds nothing, two captures have one name, not exactly one
            calibration fits a capture, or a group is not of one rig.
    """
    file = Path(path).absolute()
    wanted = load_project_file(file)
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
        fitting, left_out = fitting_products(table, wanted.project, own, headers)
        formats = wanted.project.formats if table.formats is None else table.formats
        for name, products in fitting.items():
            found[name] = ProjectCapture(name, own[name], of_rig[name], table.settings, products, formats)
        notes += left_out
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
        if Path(os.path.realpath(capture.address)) in inside:
            raise ConfigError(
                f"{path}: output: {project.wanted.project.output} is in the capture {capture.name}, expected a folder "
                "of its own."
            )


def _captures(home: Path, pattern: str) -> Sequence[str]:
    """The addresses of the captures that a pattern finds."""
    places = sorted(glob.glob(pattern, root_dir=home))
    if len(places) > MOST_CAPTURES:
        raise ConfigError(f'the pattern "{pattern}" finds {len(places)} places, expected at most {MOST_CAPTURES}.')
    return [str(home / place) for place in places if os.path.isfile(home / place / HEADER_NAME)]


def _place(home: Path, address: str) -> str:
    """The same text for the same place."""
    return os.path.realpath(home / address)


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
