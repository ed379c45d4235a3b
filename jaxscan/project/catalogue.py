"""The catalogue of a project's products, in a database: inputs, time, place and outcome of each step."""

import json
import os
import sqlite3
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple
from urllib.parse import quote

from jaxscan.errors import ConfigError, DependencyError
from jaxscan.files.disk import is_outside, open_regular, open_to_write, reported
from jaxscan.project.project import Project


STATES = ("begun", "done", "failed")
IN_MEMORY = "sqlite://"
TRUSTED = "JAXSCAN_CATALOGUES"
"""Variable of the environment: addresses of the servers, separated by blanks, that a project may name."""
_NAMES_ANOTHER = bytes.fromhex("d9d505f920a163d7")
"""The last bytes of a journal that names a file to be removed, which one of a single database never does."""
_TEXTS = ("key", "digest", "state", "message", "host", "version", "details")


class Output(NamedTuple):
    """A file that a step wrote."""

    path: str
    """In the folder of the products."""
    size: int
    sha256: str


class Row(NamedTuple):
    """A step that was done or failed. Of each digest of a key there is one, the last."""

    key: str
    digest: str
    state: str
    """"done" or "failed"; "begun" of one that was handed out and has not come back."""
    message: str
    """The line that says why it failed; notes of one that is done."""
    parts: Mapping[str, str]
    """As `parts_of` gives them."""
    outputs: tuple[Output, ...]
    started_s: float
    """Seconds since 1970."""
    seconds: float
    host: str
    """Machine and process that did it."""
    version: str
    """Of jaxscan."""
    details: str = ""
    """Where in the program an unexpected error arose."""


class Catalogue:
    """An open catalogue; the batch's own process alone writes to it."""

    def __init__(self, address: str | Path, project: str, *, write: bool = True) -> None:
        """Open it.

        Args:
            address: As SQLAlchemy has it, such as "postgresql+psycopg://..."; or a file of SQLite.
            project: Name of the project; several may share a database.
            write: Whether the file and its table are made where there are none; else nothing is ever written.

        Raises:
            ConfigError: If it cannot be opened; the message names no password.
            DependencyError: If SQLAlchemy, or the database's own library, is not installed.
        """
        try:
            import sqlalchemy
        except ImportError as problem:
            raise DependencyError('the catalogue: needs SQLAlchemy: pip install "jaxscan[fleet]".') from problem
        self._sql, self._project = sqlalchemy, project
        text, metadata = sqlalchemy.Text, sqlalchemy.MetaData()
        names = ("project", *_TEXTS, "parts", "outputs")
        self._table = sqlalchemy.Table(
            "jaxscan_products",
            metadata,
            *(sqlalchemy.Column(name, text, nullable=False, primary_key=name in names[:3]) for name in names),
            sqlalchemy.Column("started_s", sqlalchemy.Double, nullable=False),
            sqlalchemy.Column("seconds", sqlalchemy.Double, nullable=False),
        )
        try:
            if isinstance(address, Path):
                _check_file(address, write=write)
                connect = partial(_connected, _uri(address, write=write))
                self._engine = sqlalchemy.create_engine("sqlite://", creator=connect, poolclass=sqlalchemy.QueuePool)
            else:
                self._engine = sqlalchemy.create_engine(address)
            if isinstance(address, Path):
                self._check_schema(address)
            if write or address == IN_MEMORY:
                metadata.create_all(self._engine)
            self._empty = not sqlalchemy.inspect(self._engine).has_table(self._table.name)
        except ImportError as problem:
            raise DependencyError(
                f"the catalogue: its database needs {problem.name}, which is not installed."
            ) from None
        except (sqlalchemy.exc.SQLAlchemyError, ValueError) as problem:
            raise ConfigError(f"the catalogue: cannot be opened: {_first_line(problem)}.") from None

    def _check_schema(self, path: Path) -> None:
        """Check that a file holds tables and indexes alone: triggers and views would run a stranger's statements.

        Raises:
            ConfigError: If it holds something else.
        """
        query = self._sql.text("SELECT type, name FROM sqlite_master WHERE type IN ('trigger', 'view') OR sql LIKE :v")
        with self._engine.connect() as connection:
            found = connection.execute(query, {"v": "create virtual%"}).first()
        if found is not None:
            kind = "virtual table" if found.type == "table" else found.type
            self.close()
            raise ConfigError(f"the catalogue: {path}: found a {kind}, {found.name:.40}, expected plain tables.")

    def rows(self) -> list[Row]:
        """All rows of the project, the oldest first.

        Raises:
            ConfigError: If they cannot be read, or are none of ours.
        """
        if self._empty:
            return []
        table = self._table
        query = self._sql.select(table).where(table.c.project == self._project).order_by(table.c.started_s)
        try:
            with self._engine.connect() as connection:
                return [_row(dict(found)) for found in connection.execute(query).mappings()]
        except self._sql.exc.SQLAlchemyError as problem:
            raise ConfigError(f"the catalogue: cannot be read: {_first_line(problem)}.") from None
        except (KeyError, TypeError, ValueError, RecursionError) as problem:
            raise ConfigError("the catalogue: a row is damaged; remove it, and all is made anew.") from problem

    def write(self, rows: Sequence[Row]) -> None:
        """Write rows, all or none; one of the same key and digest takes the place of the one before.

        Raises:
            ConfigError: If they cannot be written.
        """
        if not rows:
            return
        table = self._table
        values = [{"project": self._project, **_values(row)} for row in rows]
        of = self._sql.bindparam
        same = table.delete().where(
            table.c.project == self._project, table.c.key == of("of_key"), table.c.digest == of("of_digest")
        )
        try:
            with self._engine.begin() as connection:
                connection.execute(same, [{"of_key": row.key, "of_digest": row.digest} for row in rows])
                connection.execute(table.insert(), values)
        except self._sql.exc.SQLAlchemyError as problem:
            raise ConfigError(f"the catalogue: cannot be written: {_first_line(problem)}.") from None

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()


def open_catalogue(project: Project, *, write: bool = True) -> Catalogue:
    """The catalogue of a project: its own database, or a file of SQLite in the folder of its products.

    Where there is none yet and nothing is to be written, it is an empty one in memory. A file of SQLite that is named
    without its whole path lies beside the project's file. One outside of the project's folder is never made, for the
    project may be a stranger's.

    Raises:
        ConfigError: If it cannot be opened, is a link, is to be made outside, or is on a server that the user's
            environment does not name.
        DependencyError: If what it needs is not installed.
    """
    wanted, file = project.wanted.project, project.output / "catalogue.sqlite"
    if wanted.catalogue:
        scheme, _, place = wanted.catalogue.partition("://")
        if scheme.partition("+")[0].lower() != "sqlite":
            # A server that a stranger names would learn who asks, with the user's own name and password.
            if "://" in wanted.catalogue and wanted.catalogue not in os.environ.get(TRUSTED, "").split():
                raise ConfigError(
                    f"the catalogue: {scheme:.40}://… is a server, which a stranger may have named: if "
                    f"you know it, set {TRUSTED} to the whole address."
                )
            return Catalogue(wanted.catalogue, wanted.name, write=write)
        place = place.removeprefix("/")
        if place in ("", ":memory:"):
            return Catalogue(IN_MEMORY, wanted.name)
        if place.startswith("file:"):
            raise ConfigError("the catalogue: found an address with file:, expected sqlite:/// and a path.")
        file = project.file.parent / place
        if is_outside(file, project.file.parent) and not os.path.lexists(file):
            raise ConfigError(
                f"the catalogue: {file} is not there and would lie outside of {project.file.parent}, where a project "
                "makes none; make an empty file there, if you mean it."
            )
    there = write and (wanted.catalogue or project.output.is_dir())
    return Catalogue(file if there or os.path.lexists(file) else IN_MEMORY, wanted.name, write=write)


def _check_file(path: Path, *, write: bool) -> None:
    """Check that a file of SQLite, and those that SQLite keeps beside it, are no links; make it where it is missing.

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


def _connected(uri: str) -> sqlite3.Connection:
    connection = sqlite3.connect(uri, uri=True, check_same_thread=False)
    # What the tables of a stranger call by themselves, in a check or a default, may then do nothing but compute.
    connection.execute("PRAGMA trusted_schema=OFF")
    return connection


def _uri(path: Path, *, write: bool) -> str:
    return f"file:{quote(str(path.absolute()))}?mode={'rw' if write else 'ro'}"


def row_to_json(row: Row) -> str:
    """A row as text, for its way from a worker."""
    return json.dumps(row._asdict() | {"outputs": [tuple(one) for one in row.outputs], "parts": dict(row.parts)})


def row_from_json(text: str) -> Row:
    """The row of a text."""
    return _made(json.loads(text))


def _values(row: Row) -> dict[str, Any]:
    """The columns of a row. Names of files may hold bytes that are no letters, which no database takes."""
    fields = row._asdict() | {"parts": json.dumps(dict(row.parts)), "outputs": json.dumps(row.outputs)}
    return {key: _as_text(value) if isinstance(value, str) else value for key, value in fields.items()}


def _as_text(value: str) -> str:
    return value.encode(errors="backslashreplace").decode()


def _row(found: Mapping[str, Any]) -> Row:
    fields = {name: found[name] for name in Row._fields}
    return _made(fields | {name: json.loads(fields[name]) for name in ("parts", "outputs")})


def _made(fields: Mapping[str, Any]) -> Row:
    """The row of its fields, each of which may be anything: a database may come from a stranger.

    Raises:
        ValueError: If it is none.
    """
    outputs = tuple(Output(*one) for one in fields["outputs"])
    row = Row(**{**fields, "outputs": outputs})
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


def _first_line(problem: Exception) -> str:
    """An error of the database without the statement and the link that SQLAlchemy adds."""
    cause = getattr(problem, "orig", None) or problem
    return str(cause).strip().splitlines()[0].rstrip(".") if str(cause).strip() else type(cause).__name__
