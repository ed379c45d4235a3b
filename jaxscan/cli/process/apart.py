"""Compiles the code of a reconstruction in a process of its own, which leaves it in the caches on disk.

Numba holds Python's lock while it compiles, and frames are rendered by threads that need it.

    python -P -m jaxscan.cli.process.apart '{"image_size": [640, 512], ...}'
"""

import json
import os
import subprocess
import sys
import threading
from dataclasses import asdict

from jaxscan.api.kept_code import cache_on_disk, is_kept, remember
from jaxscan.api.sweep_rehearsal import ExpectedSweep, rehearse_reconstruction
from jaxscan.stripes import LaserLine


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
    # Without the current folder, which may hold anything, on the path of modules.
    fields = json.dumps(expected._asdict() | {"line": asdict(expected.line)})
    words = [sys.executable, "-P", "-m", __spec__.name, fields]
    kept = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    nowhere = subprocess.DEVNULL
    # The process ends when this one does: its standard input is closed then.
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere, env={**os.environ, **kept}
    ) as process:
        if process.wait() == 0:
            remember(kind)


def main() -> None:
    """Rehearse what the first word says."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    fields = json.loads(sys.argv[1])
    line = LaserLine(**fields.pop("line"))
    rehearse_reconstruction(ExpectedSweep(**fields | {"image_size": tuple(fields["image_size"]), "line": line}))
    # While the interpreter ends, threads of XLA may crash.
    os._exit(0)


def _end_with_parent() -> None:
    os.read(0, 1)
    os._exit(1)


if __name__ == "__main__":
    main()
