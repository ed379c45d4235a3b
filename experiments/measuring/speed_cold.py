"""The first result, for `speed.py`: the demo, and a calibration of its boards, in processes of their own.

"Cold" means that nothing is compiled: JAX finds nothing on the disk. "Again" is
the same command in a new process, with the compiled code of the first one; it renders everything anew.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from measuring.speed_times import Figure


def cold_figures(scratch: Path) -> list[Figure]:
    """Seconds of the demo and of a calibration, cold and again.

    Args:
        scratch: Empty folder for captures and compiled code.
    """
    figures = []
    for run, demo_s, boards_s in (("cold", 60.0, 20.0), ("again", 35.0, 8.0)):
        demo, wall, processor = _run(scratch / "of demo", "demo", "-o", str(scratch / run))
        figures.append(Figure(f"demo, {run}", wall, "s", "lower", 0.2, demo_s))
        figures.append(Figure(f"demo, {run}, processor", processor, "s", "lower", 0.1))
        figures += [
            Figure(f"demo, {run}, of that {part}", demo["seconds_s"][part], "s", "lower", 0.3)
            for part in ("render", "calibrate", "reconstruct", "measure")
        ]
        boards = str(scratch / "cold" / "captures" / "boards")
        _, wall, processor = _run(scratch / "of boards", "calibrate", boards, "-o", str(scratch / f"{run}.json"))
        figures.append(Figure(f"calibrate 50 boards, {run}", wall, "s", "lower", 0.2, boards_s))
        figures.append(Figure(f"calibrate 50 boards, {run}, processor", processor, "s", "lower", 0.1))
    return figures


def _run(cache: Path, *words: str) -> tuple[dict[str, Any], float, float]:
    """The JSON that `jaxscan` prints, its wall time and its processor time [s]."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    environment |= {"XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-m", "jaxscan.cli.main", *words, "--json", "-"]
    started, before = time.perf_counter(), os.times()
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
    wall, after = time.perf_counter() - started, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return json.loads(done.stdout), wall, used
