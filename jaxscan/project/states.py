"""The state of each step of a project, and the reason for it."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from jaxscan.project.catalogue import Row
from jaxscan.project.steps import Step


State = Literal["done", "stale", "failed", "missing"]


class Status(NamedTuple):
    """The state of one step."""

    step: Step
    digest: str
    """Of the step as it would be done now."""
    parts: Mapping[str, str]
    state: State
    why: str
    """The reason in a few words; the notes of a step that is done."""


def states_of(
    steps: Sequence[Step],
    digests: Mapping[str, str],
    parts: Mapping[str, Mapping[str, str]],
    rows: Sequence[Row],
    output: Path,
) -> list[Status]:
    """The state of every step, in their order.

    Args:
        steps: Each after those that it needs.
        digests: Of each, by key, as it would be done now.
        parts: What each depends on, by key.
        rows: Of the catalogue, the oldest first.
        output: The folder of the products; each is asked whether it is there, and for its size.
    """
    now = {(row.key, row.digest): row for row in rows}
    last = {row.key: row for row in rows if row.state != "failed"}
    made = {row.key for row in rows if row.state == "done"}
    found = []
    for step in steps:
        row = now.get((step.key, digests[step.key]))
        state, why = _state(parts[step.key], row, last.get(step.key), output)
        if state == "stale" and step.key not in made:
            state = "missing"
        found.append(Status(step, digests[step.key], parts[step.key], state, why))
    return found


def _state(parts: Mapping[str, str], row: Row | None, last: Row | None, output: Path) -> tuple[State, str]:
    """Args: the row of this digest, and the last one of any digest that wrote files or may have."""
    if row is not None and row.state == "failed":
        return "failed", row.message
    if last is None:
        return "missing", ""
    if last.state == "begun":
        return "stale", "was begun, and did not come to its end"
    # Another digest, made later, wrote the same files.
    if row is None or last.digest != row.digest:
        return "stale", _changed(parts, last)
    wrong = next((words for one in row.outputs if (words := _wrong(output / one.path, one.size))), "")
    return ("stale", wrong) if wrong else ("done", row.message)


def _wrong(path: Path, size: int) -> str:
    try:
        return "" if os.stat(path).st_size == size else f"{path.name} was changed"
    except OSError:
        return f"{path.name} is gone"


def _changed(parts: Mapping[str, str], last: Row) -> str:
    """The parts that differ from those when it was done last, in words."""
    names = [name for name in parts if parts[name] != last.parts.get(name)]
    names += [name for name in last.parts if name not in parts]
    words = [f"the code, which was version {last.version}" if name == "code" else name for name in names]
    return f"changed: {', '.join(words)}" if words else "was made anew with other inputs"
