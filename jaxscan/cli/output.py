"""What a verb leaves behind for machines (`--json`) and for people (tables)."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from jaxscan.files.disk import check_writable, write_atomically


JsonTarget = Annotated[
    str | None, tyro.conf.arg(name="json", metavar="FILE", help="Write the result as JSON too (- for standard output).")
]


def check_json(target: str | None) -> None:
    """See that the JSON can be written, before the work that makes it.

    Raises:
        JaxscanError: If its folder is missing or cannot be written.
    """
    if target is not None and target != "-":
        check_writable(target)


def emit_json(target: str | None, verb: str, result: dict[str, Any]) -> None:
    """Write `result` as `jaxscan-<verb>/1` to a file, or to standard output for "-"."""
    if target is None:
        return
    text = json.dumps({"format": f"jaxscan-{verb}/1", **result}, indent=2, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
    else:
        write_atomically(Path(target), text.encode())


def console(json_target: str | None = None) -> Console:
    """Where people read: standard output, unless that is where the JSON goes."""
    # A path that is wrapped, or of which a part is taken for markup, cannot be used again.
    made = Console(stderr=json_target == "-", highlight=False, markup=False, soft_wrap=True)
    if not made.is_terminal:
        made.width = 160
    return made


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table whose first column is text and whose others are numbers."""
    made = Table(title=title, title_justify="left", title_style="bold")
    for i, column in enumerate(columns):
        made.add_column(column, justify="left" if i == 0 else "right", no_wrap=True)
    for row in rows:
        made.add_row(*row)
    return made
