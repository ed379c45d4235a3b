"""Work of the demo in processes of their own: compiling the reconstruction, and rendering the sweep.

Numba holds Python's lock while it compiles, and NumPy between its many small steps; another process has its own.

    python -P -m jaxscan.cli.process.apart rehearse '{"image_size": [640, 512], ...}'
    python -P -m jaxscan.cli.process.apart sweep '{"folder": ..., "config": {...}}'
"""

import contextlib
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO, cast

from jaxscan.api import simulate_sweep
from jaxscan.api.kept_code import cache_on_disk, is_kept, remember
from jaxscan.api.sweep_rehearsal import ExpectedSweep, rehearse_reconstruction
from jaxscan.errors import CaptureError, JaxscanError
from jaxscan.observation import Progress
from jaxscan.simulation import SimulationConfig
from jaxscan.stripes import LaserLine


_REFUSED = 3
"""Exit code after a line that says why."""

_PROGRESS = re.compile(r"(\d+) of (\d+)\n")

running: list["subprocess.Popen[str]"] = []
"""The processes that this one has started and not ended yet."""


def rehearse_apart(expected: ExpectedSweep) -> None:
    """Compile what `rehearse_reconstruction` compiles, and wait for it; nothing where that is on disk already.

    Where code is not kept on disk it is compiled by this process, or it would be lost.
    """
    kind, cache = ("reconstruction", expected, os.cpu_count()), cache_on_disk()
    if is_kept(kind):
        return
    if cache is None or not sys.executable:
        rehearse_reconstruction(expected)
        return
    kept = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    with _started("rehearse", expected._asdict() | {"line": asdict(expected.line)}, kept) as process:
        if process.wait() == 0:
            remember(kind)


@contextlib.contextmanager
def sweep_apart(config: SimulationConfig, folder: Path) -> Iterator[Callable[[Progress], None]]:
    """Render the sweep of a configuration into a folder of `new_simulation` while `with` goes on.

    Yields:
        Waits until the sweep is complete, while it tells how many pairs of how many are done.

    Raises:
        CaptureError: When it is waited for, if the sweep cannot be rendered or written.
    """
    with _started("sweep", {"folder": str(folder), "config": config.model_dump(mode="json")}, {}) as process:

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
def _started(kind: str, fields: Mapping[str, Any], environment: Mapping[str, str]) -> Iterator["subprocess.Popen[str]"]:
    """A process that ends with `with`, and when this one does: its standard input is closed then."""
    # Without the current folder, which may hold anything, on the path of modules.
    words = [sys.executable or "python3", "-P", "-m", __spec__.name, kind, json.dumps(fields)]
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    with subprocess.Popen(
        words, stdin=pipe, stdout=pipe, stderr=nowhere, text=True, env={**os.environ, **environment}
    ) as process:
        running.append(process)
        try:
            yield process
        finally:
            process.kill()
            process.wait()
            running.remove(process)


def main() -> None:
    """Do the work that the first word names."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    kind, fields = sys.argv[1], json.loads(sys.argv[2])
    code = 1
    try:
        if kind == "rehearse":
            line = LaserLine(**fields.pop("line"))
            rehearse_reconstruction(ExpectedSweep(**fields | {"image_size": tuple(fields["image_size"]), "line": line}))
        else:
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
