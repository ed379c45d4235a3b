"""How much processor time a task took per unit of its work, remembered from run to run."""

import json
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from jaxscan.cli.environment import cache_folder
from jaxscan.errors import JaxscanError, OutputError
from jaxscan.files import disk


_MOST_TASKS = 50


def pace_of(task: str) -> float | None:
    """Seconds of processor time per unit of work in the last run of a task on this machine; None if there was none."""
    found = _read().get(task)
    known = isinstance(found, float) and math.isfinite(found) and found > 0
    return found if known else None


def remember_pace(task: str, seconds: float) -> None:
    """Remember it for the next run."""
    if (file := _file()) is None or not seconds > 0:
        return
    kept = {name: pace for name, pace in _read().items() if name != task}
    paces = dict([*kept.items(), (task, seconds)][-_MOST_TASKS:])
    # Without it the next estimate is a coarse one; no task fails for that.
    with suppress(OSError, JaxscanError):
        disk.make_folder(file.parent)
        disk.write_atomically(file, json.dumps(paces).encode(), durable=False)


def _file() -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / "paces.json"


def _read() -> dict[str, Any]:
    """All that is remembered. A file that is no such table counts as none."""
    file = _file()
    if file is None or not file.is_file():
        return {}
    try:
        found = json.loads(disk.read_bounded(file, disk.MEGABYTE, error=OutputError))
    except (OSError, ValueError, RecursionError, JaxscanError):
        return {}
    return found if isinstance(found, dict) else {}
