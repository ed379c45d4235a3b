"""Output of a verb: JSON for machines (`--json`), tables for people."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table


JsonTarget = Annotated[
    str | None, tyro.conf.arg(name="json", metavar="FILE", help="Write the result as JSON too (- for standard output).")
]


def check_json(target: str | None) -> None:
    """Check that the JSON can be written, before the work begins.

    Raises:
        JaxscanError: If its folder is missing or cannot be written.
    """
    # Imported here and below, so that `--help` does not load JAX.
    from jaxscan.files.disk import check_writable

    if target is not None and target != "-":
        check_writable(target)


def emit_json(target: str | None, verb: str, result: dict[str, Any]) -> None:
    """Write `result` as `jaxscan-<verb>/1` to a file, or to standard output for "-"; arrays become lists."""
    from jaxscan.files.disk import write_atomically

    if target is None:
        return
    entries = {"format": f"jaxscan-{verb}/1", **result}
    text = json.dumps(entries, indent=2, allow_nan=False, default=lambda array: array.tolist()) + "\n"
    if target == "-":
        sys.stdout.write(text)
    else:
        write_atomically(Path(target), text.encode())


def console(json_target: str | None = None) -> Console:
    """Console for people: standard output, or standard error where the JSON goes to standard output."""
    # Without wrapping and markup, so that printed paths and commands can be copied.
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
