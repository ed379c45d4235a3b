"""Output of a verb: JSON for machines (`--json`), tables for people."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from jaxscan.cli.process.terminal import Terminal
from jaxscan.errors import OutputError


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
    """Write `result` as `jaxscan-<verb>/1` to a file, or to standard output for "-"; arrays become lists.

    Raises:
        JaxscanError: If it cannot be written.
        BrokenPipeError: If nobody reads standard output.
    """
    from jaxscan.files.disk import write_atomically

    if target is None:
        return
    entries = {"format": f"jaxscan-{verb}/1", **result}
    text = json.dumps(entries, indent=2, allow_nan=False, default=lambda array: array.tolist()) + "\n"
    if target == "-":
        _print_json(text)
    else:
        write_atomically(Path(target), text.encode())


def _print_json(text: str) -> None:
    if sys.stdout is None:
        raise OutputError("standard output: is closed, so that --json - cannot be written.")
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as problem:
        raise OutputError(f"standard output: cannot be written: {problem.strerror}.") from problem


def console(json_target: str | None = None) -> Terminal:
    """The terminal for people: standard output, or standard error where the JSON goes to standard output."""
    return Terminal(stderr=json_target == "-")
