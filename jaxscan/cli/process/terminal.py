"""The door to the terminal: people read here, and nothing that is printed steers the terminal."""

import sys
from collections.abc import Sequence
from typing import final

from rich.console import Console
from rich.table import Table

from jaxscan.errors import OutputError
from jaxscan.printable import printable


@final
class Terminal:
    """Prints lines and tables, in colour where somebody sees it."""

    def __init__(self, *, stderr: bool = False) -> None:
        """Print to standard output, or to standard error."""
        # Without wrapping, markup and emoji codes, so that printed paths and commands can be copied.
        self.console = Console(
            file=sys.stderr if stderr else sys.stdout, highlight=False, markup=False, emoji=False, soft_wrap=True
        )
        """For moving displays, which have to print their own fields through `printable`."""
        self.console.on_broken_pipe = _raise_again  # type: ignore[method-assign]
        if not self.console.is_terminal:
            self.console.width = 160

    @property
    def is_terminal(self) -> bool:
        """Whether a person may see it."""
        return self.console.is_terminal

    def print(self, text: str | Table, style: str = "") -> None:
        """Print one line, or a table that `table` made.

        Raises:
            OutputError: If it cannot be written.
            BrokenPipeError: If nobody reads.
        """
        try:
            self.console.print(printable(text) if isinstance(text, str) else text, style=style)
        except BrokenPipeError:
            raise
        except OSError as problem:
            raise OutputError(f"standard output: cannot be written: {problem.strerror}.") from problem


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table whose first column is text and whose others are numbers."""
    made = Table(title=printable(title), title_justify="left", title_style="bold")
    for i, column in enumerate(columns):
        made.add_column(printable(column), justify="left" if i == 0 else "right", no_wrap=True)
    for row in rows:
        made.add_row(*map(printable, row))
    return made


def _raise_again() -> None:
    """In place of rich's own answer, which ends the process with code 1."""
    raise
