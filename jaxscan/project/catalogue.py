"""The catalogue of a project's products, a file of SQLite among them: inputs, time, place and outcome of each step."""

import contextlib
import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple
from urllib.parse import quote

from jaxscan.errors import ConfigError
from jaxscan.files.disk import open_regular, open_to_write, reported
from jaxscan.project.project import Project


STATES = ("begun", "done", "failed")
_NAMES_ANOTHER = bytes.fromhex("d9d505f920a163d7")
"""The last bytes of a journal that names a file to be removed, which one of a single database never does."""
_TEXTS = ("key", "digest", "state", "message", "host", "version", "details")
_COLUMNS = ("project", *_TEXTS, "parts", "outputs", "started_s", "seconds")
_TABLE = f"""CREATE TABLE IF NOT EXISTS jaxscan_products (
    {", ".join(f"{name} TEXT NOT NULL" for name in _COLUMNS[:-2])},
    started_s DOUBLE NOT NULL, seconds DOUBLE NOT NULL, PRIMARY KEY (project, key, digest))"""


class Output(NamedTuple):
    """A file that a step wrote."""

    path: str
    """Path in the folder of the products."""
    size: int
    sha256: str


class Row(NamedTuple):
    """A step that was done or failed. Only the last row of each key and digest is kept."""

    key: str
    digest: str
    state: str
    """"done" or "failed"; "begun" for one that is still at work, or was interrupted."""
    message: str
    """The line that says why it failed; notes of one that is done."""
    parts: Mapping[str, str]
    """The result of `parts_of`."""
    outputs: tuple[Output, ...]
    started_s: float
    """Seconds since 1970."""
    seconds: float
    host: str
    """Machine and process that did it."""
    version: str
    """Version of jaxscan that did it."""
    details: str = ""
    """Where in the program an unexpected error arose."""


class Catalogue:
    """An open catalogue; the batch's own process alone writes to it."""

    def __init__(self, path: Path, project: str, *, write: bool = True) -> None:
        """Open it.

        Args:
            path: The file.
            project: Name of the project.
            write: Whether the file is made where there is none; else nothing is ever written.

        Raises:
            ConfigError: If it cannot be opened, is a link, or would run statements of its own.
        """
        self._project, self._database = project, None
        _check_file(path, write=write)
        if not os.path.lexists(path):
            return
        with _reported("opened"):
            uri = f"file:{quote(str(path.absolute()))}?mode={'rw' if write else 'ro'}"
            self._database = sqlite3.connect(uri, uri=True)
            try:
                # Functions that a stranger's tables call may then only compute.
                self._database.execute("PRAGMA trusted_schema=OFF")
                _check_schema(self._database, path)
                if write:
                    self._database.execute(_TABLE)
            except BaseException:
                self.close()
                raise

    def rows(self) -> list[Row]:
        """All rows of the project, the oldest first.

        Raises:
            ConfigError: If they cannot be read, or are none of ours.
        """
        if self._database is None:
            return []
        query = f"SELECT {', '.join(_COLUMNS[1:])} FROM jaxscan_products WHERE project = ? ORDER BY started_s"
        try:
            with _reported("read"):
                if not self._database.execute("SELECT 1 FROM sqlite_master WHERE name = 'jaxscan_products'").fetchone():
                    return []
                found = self._database.execute(query, (self._project,)).fetchall()
            return [_row(dict(zip(_COLUMNS[1:], values, strict=True))) for values in found]
        except (KeyError, TypeError, ValueError, RecursionError) as problem:
            raise ConfigError("the catalogue: a row is damaged; remove it, and all is made anew.") from problem

    def write(self, rows: Sequence[Row]) -> None:
        """Write rows, all or none; one of the same key and digest takes the place of the one before.

        Raises:
            ConfigError: If they cannot be written.
        """
        if not rows:
            return
        if self._database is None:
            raise ConfigError("the catalogue: cannot be written: it is not there.")
        places = ", ".join(f":{name}" for name in _COLUMNS)
        insert = f"INSERT OR REPLACE INTO jaxscan_products ({', '.join(_COLUMNS)}) VALUES ({places})"
        with _reported("written"), self._database:
            self._database.executemany(insert, [{"project": self._project, **_values(row)} for row in rows])

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()


def open_catalogue(project: Project, *, write: bool = True) -> Catalogue:
    """The catalogue of a project, in the folder of its products; an empty one where there is none to read.

    Raises:
        ConfigError: As of `Catalogue`.
    """
    file = project.output / "catalogue.sqlite"
    return Catalogue(file, project.wanted.project.name, write=write and project.output.is_dir())


@contextlib.contextmanager
def _reported(what: str) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as problem:
        raise ConfigError(f"the catalogue: cannot be {what}: {problem}.") from None


def _check_file(path: Path, *, write: bool) -> None:
    """Check that the file, and those that SQLite keeps beside it, are no links; make it where it is missing.

    Raises:
        ConfigError: If one is a link or no file, or the journal names a file elsewhere, which SQLite would remove.
    """
    with reported(f"the catalogue: {path}: cannot be opened", error=ConfigError):
        for name in (path, *(path.with_name(path.name + end) for end in ("-journal", "-wal", "-shm"))):
            if os.path.lexists(name):
                with open_regular(name, error=ConfigError, links="refuse") as file:
                    if name.name.endswith("-journal") and file.seek(0, os.SEEK_END) >= len(_NAMES_ANOTHER):
                        file.seek(-len(_NAMES_ANOTHER), os.SEEK_END)
                        if file.read() == _NAMES_ANOTHER:
                            raise ConfigError(f"{name}: names another file, which would be lost; remove both.")
                    elif name == path and not write and file.read(20)[18:] == b"\2\2":
                        raise ConfigError(f"{path}: found a database in WAL mode, of which SQLite cannot only read.")
        if write and not os.path.lexists(path):
            open_to_write(path, "make").close()


def _check_schema(database: sqlite3.Connection, path: Path) -> None:
    """Check that there are tables and indexes alone: triggers and views would run a stranger's statements.

    Raises:
        ConfigError: If there is something else.
    """
    query = "SELECT type, name FROM sqlite_master WHERE type IN ('trigger', 'view') OR sql LIKE 'create virtual%'"
    found = database.execute(query).fetchone()
    if found is not None:
        kind = "virtual table" if found[0] == "table" else found[0]
        raise ConfigError(f"the catalogue: {path}: found a {kind}, {found[1]!s:.40}, expected plain tables.")


def _values(row: Row) -> dict[str, Any]:
    """The columns of a row. Names of files may hold bytes that are no letters, which no database takes."""
    fields = row._asdict() | {"parts": json.dumps(dict(row.parts)), "outputs": json.dumps(row.outputs)}
    return {
        key: value.encode(errors="backslashreplace").decode() if isinstance(value, str) else value
        for key, value in fields.items()
    }


def _row(found: Mapping[str, Any]) -> Row:
    """The row of its columns, each of which may be anything: a catalogue may come from a stranger.

    Raises:
        ValueError: If it is none.
    """
    outputs = tuple(Output(*one) for one in json.loads(found["outputs"]))
    row = Row(**{**found, "parts": json.loads(found["parts"]), "outputs": outputs})
    texts = [getattr(row, name) for name in _TEXTS] + [one.path for one in outputs] + [one.sha256 for one in outputs]
    texts += [*row.parts.keys(), *row.parts.values()] if isinstance(row.parts, dict) else [None]
    numbers = [row.started_s, row.seconds, *(one.size for one in outputs)]
    if not all(isinstance(one, str) for one in texts) or not all(isinstance(one, int | float) for one in numbers):
        raise ValueError("a field of another type")
    if row.state not in STATES:
        raise ValueError("a state that there is not")
    if not all(_is_inside(one.path) for one in outputs):
        raise ValueError("a product outside of the folder of the products")
    return row


def _is_inside(path: str) -> bool:
    return "\0" not in path and not PurePosixPath(path).is_absolute() and ".." not in PurePosixPath(path).parts
