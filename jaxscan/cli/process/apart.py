"""Rendering the demo's sweep in a process of its own: NumPy holds Python's lock between its many small steps.

python -P -m jaxscan.cli.process.apart '{"folder": ..., "config": {...}}'
"""

import contextlib
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO, cast

from jaxscan.api import simulate_sweep
from jaxscan.errors import CaptureError, JaxscanError
from jaxscan.observation import Progress
from jaxscan.simulation import SimulationConfig


_REFUSED = 3
"""Exit code after a line that says why."""

_PROGRESS = re.compile(r"(\d+) of (\d+)\n")

running: list["subprocess.Popen[str]"] = []
"""The processes that this one has started and not ended yet."""


@contextlib.contextmanager
def sweep_apart(config: SimulationConfig, folder: Path) -> Iterator[Callable[[Progress], None]]:
    """Render the sweep of a configuration into a folder of `new_simulation` while `with` goes on.

    Yields:
        Waits until the sweep is complete, while it tells how many pairs of how many are done.

    Raises:
        CaptureError: When it is waited for, if the sweep cannot be rendered or written.
    """
    with _started({"folder": str(folder), "config": config.model_dump(mode="json")}) as process:

        def wait(progress: Progress) -> None:
            last = ""
            for last in cast(TextIO, process.stdout):
                if told := _PROGRESS.fullmatch(last):
                    progress(*map(int, told.groups()))
            if process.wait() == _REFUSED:
                raise CaptureError(last.strip())
            if process.returncode != 0:
                raise RuntimeError(f"rendering the sweep ended with code {process.returncode}: {last.strip()}")

        yield wait


def end_processes() -> None:
    """End what runs apart, before this process ends by a signal and removes the folders it writes to."""
    for process in list(running):
        process.kill()
        process.wait()


@contextlib.contextmanager
def _started(fields: Mapping[str, Any]) -> Iterator["subprocess.Popen[str]"]:
    """A process that ends with `with`, and when this one does: its standard input is closed then."""
    # Without the current folder, which may hold anything, on the path of modules.
    words = [sys.executable or "python3", "-P", "-m", __spec__.name, json.dumps(fields)]
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=nowhere, text=True) as process:
        running.append(process)
        try:
            yield process
        finally:
            process.kill()
            process.wait()
            running.remove(process)


def main() -> None:
    """Render the sweep that the first word describes."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    fields = json.loads(sys.argv[1])
    code = 1
    try:
        config = SimulationConfig.model_validate_json(json.dumps(fields["config"]))
        simulate_sweep(config, Path(fields["folder"]), progress=_print_progress)
        code = 0
    except (JaxscanError, OSError) as problem:
        print("", *str(problem).split(), flush=True)
        code = _REFUSED
    except Exception as problem:
        print("", type(problem).__name__, *str(problem).split(), flush=True)
    finally:
        # While the interpreter ends, threads of XLA may crash.
        os._exit(code)


def _print_progress(done: int, pairs: int) -> None:
    print(f"{done} of {pairs}", flush=True)


def _end_with_parent() -> None:
    os.read(0, 1)
    os._exit(1)


if __name__ == "__main__":
    main()
