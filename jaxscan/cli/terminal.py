"""What people and machines read: lines and tables that do not steer the terminal, and JSON (`--json`)."""

import contextlib
import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple, final

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from jaxscan.errors import OutputError
from jaxscan.files import disk
from jaxscan.printable import printable


_WIDTH = 160
"""Columns where the output is no terminal, and the environment names none."""

_UNLIMITED = 1_000_000
"""Columns for any table."""


class Sheet(NamedTuple):
    """A table to be printed: its first column is text, the others are numbers."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@final
class Terminal:
    """Prints lines and tables, in colour where somebody sees it."""

    def __init__(self, *, stderr: bool = False) -> None:
        """Print to standard output, or to standard error.

        The variables NO_COLOR and FORCE_COLOR of the environment forbid and demand colours; rich answers to the latter.
        """
        file = sys.stderr if stderr else sys.stdout
        # Without wrapping, markup and emoji codes, so that printed paths and commands can be copied. Without a
        # system of colours there is no bold either: nothing is printed for the terminal to obey.
        self.console = Console(
            file=file,
            highlight=False,
            markup=False,
            emoji=False,
            soft_wrap=True,
            color_system=None if os.environ.get("NO_COLOR") else "auto",
        )
        """For moving displays, which have to print their own fields through `printable`."""
        self.console.on_broken_pipe = _raise_again  # type: ignore[method-assign]
        if not self.is_terminal and not os.environ.get("COLUMNS", "").isdecimal():
            self.console.width = _WIDTH

    @property
    def is_terminal(self) -> bool:
        """Whether it is a terminal; a file is none, even if FORCE_COLOR demands colours."""
        file = self.console.file
        return self.console.is_terminal and not file.closed and file.isatty()

    def print(self, text: str | Sheet, style: str = "") -> None:
        """Print one line, or a table that `table` made; where it is too wide, one line for each of its numbers.

        Raises:
            OutputError: If it cannot be written.
            BrokenPipeError: If nobody reads.
        """
        with _reported():
            for part in [printable(text)] if isinstance(text, str) else self._fitted(text):
                self.console.print(part, style=style)

    def notes(self, notes: Iterable[str]) -> None:
        """Print notes, a line each."""
        for note in notes:
            self.print(f"note: {note}")

    def _fitted(self, sheet: Sheet) -> Sequence[Table | str]:
        whole = _drawn(sheet)
        unlimited = self.console.options.update(width=_UNLIMITED)
        if Measurement.get(self.console, unlimited, whole).maximum <= self.console.width:
            return [whole]
        lines = [sheet.title]
        for name, *values in sheet.rows:
            lines.append(name)
            named = zip(sheet.columns[1:], values, strict=False)
            lines += [f"  {column}: {value}" if column else f"  {value}" for column, value in named if value]
        return [printable(line) for line in lines]


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Sheet:
    """A table whose first column is text and whose others are numbers."""
    return Sheet(title, columns, rows)


def _drawn(sheet: Sheet) -> Table:
    made = Table(title=printable(sheet.title), title_justify="left", title_style="bold")
    for i, column in enumerate(sheet.columns):
        made.add_column(printable(column), justify="left" if i == 0 else "right", no_wrap=True)
    for row in sheet.rows:
        made.add_row(*map(printable, row))
    return made


def _raise_again() -> None:
    """Replaces rich's own answer, which would end the process with code 1."""
    raise


class _Json(NamedTuple):
    """Where the running verb writes its result as JSON, "-" for standard output, and its name."""

    target: str
    verb: str


_json: ContextVar[_Json | None] = ContextVar("json", default=None)


@contextlib.contextmanager
def json_to(target: str | None, verb: str) -> Iterator[None]:
    """Within `with`, the result of a verb is written as JSON too; with None it is not."""
    token = _json.set(None if target is None else _Json(target, verb))
    try:
        yield
    finally:
        _json.reset(token)


def json_target() -> str | None:
    """Where the running verb writes JSON: a file, "-" for standard output, or nowhere."""
    found = _json.get()
    return None if found is None else found.target


def emit_json(result: dict[str, Any]) -> None:
    """Write the verb's result as `jaxscan-<verb>/1`, if that was asked for; arrays become lists.

    Raises:
        JaxscanError: If it cannot be written.
        BrokenPipeError: If nobody reads standard output.
    """
    found = _json.get()
    if found is None:
        return
    entries = {"format": f"jaxscan-{found.verb}/1", **result}
    text = json.dumps(entries, indent=2, allow_nan=False, default=lambda array: array.tolist()) + "\n"
    if found.target != "-":
        disk.write_atomically(Path(found.target), text.encode())
        return
    if sys.stdout is None:
        raise OutputError("standard output: is closed, so that --json - cannot be written.")
    with _reported():
        sys.stdout.write(text)
        sys.stdout.flush()


@contextlib.contextmanager
def _reported() -> Iterator[None]:
    """Turn errors of printing into one line; a closed pipe passes through."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as problem:
        raise OutputError(f"standard output: cannot be written: {problem.strerror}.") from problem


def console(notes: Iterable[str] = ()) -> Terminal:
    """The terminal for people, with notes on it: standard output, or standard error if the JSON goes to that."""
    out = Terminal(stderr=json_target() == "-")
    out.notes(notes)
    return out
