"""What the pipeline of one source tree costs, for `speed_against.py`: one job in a process of its own.

    python -m measuring.tree_jobs JOB FOLDER [COUNT …] [--repeats N]

Frames and scanner are read from files, so that every tree gets the same bytes. Only names of jaxscan are used that all
trees have. The result is one line of JSON.
"""

import dataclasses
import functools
import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
from measuring.speed_times import take_turns
from report import command_line

import jaxscan
from jaxscan import api
from jaxscan.files.capture import Capture, open_capture
from jaxscan.reconstruction import Sweep, reconstruct
from jaxscan.vision import decode_image


COMPILED = "/jax/core/compile/backend_compile_duration"
"""JAX's event: XLA has compiled a program."""
STAGES = {
    "open_capture": "open",
    "reconstruct_capture": "stripes and points",
    "colour_cloud": "colours",
    "save_cloud": "PLY",
}
"""Functions that `jaxscan reconstruct` calls, one after the other."""


def memory(folder: Path, counts: list[int], repeats: int) -> dict[str, Any]:
    """Best wall and processor time [s] of reconstructions of so many pairs in memory, after one to compile."""
    scanner = api.load_scanner(folder / "calibration.json")
    stacks = [np.load(folder / f"{kind}.npy") for kind in ("on", "off")]
    runs: dict[str, Callable[[], object]] = {}
    for count in counts:
        order = np.arange(count) % len(stacks[0])
        angles = np.radians(360.0 / 3600) * np.arange(count)
        runs[str(count)] = functools.partial(reconstruct, Sweep(*(stack[order] for stack in stacks), angles), scanner)
    return {count: (times.best, times.processor) for count, times in take_turns(runs, repeats).items()}


def cold(folder: Path, counts: list[int], repeats: int) -> dict[str, Any]:
    """Programs that XLA compiles for a first reconstruction from files, and its processor time, imports included."""
    del repeats
    seconds: list[float] = []

    def listen(event: str, duration: float, **about: str | int) -> None:
        del about
        if event == COMPILED:
            seconds.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    reconstruct(_first(open_capture(folder / "packed"), counts[0]), api.load_scanner(folder / "calibration.json"))
    return {"programs": len(seconds), "compiling_s": sum(seconds), "processor_s": processor_s()}


def packed(folder: Path, counts: list[int], repeats: int) -> dict[str, Any]:
    """Best wall and processor time [s] of a capture of packed frames, after a short one to compile."""
    capture, scanner = open_capture(folder / "packed"), api.load_scanner(folder / "calibration.json")
    reconstruct(_first(capture, 64), scanner)
    runs = []
    for _ in range(repeats):
        start, used = time.perf_counter(), time.process_time()
        reconstruct(_first(capture, counts[0]), scanner)
        runs.append((time.perf_counter() - start, time.process_time() - used))
    walls, used_s = zip(*runs, strict=True)
    return {"wall_s": min(walls), "processor_s": min(used_s), "peak_bytes": peak_bytes()}


def png(folder: Path, counts: list[int], repeats: int) -> dict[str, Any]:
    """Best wall and processor time [s] of a capture of PNG files: decoding alone, and a reconstruction."""
    capture, scanner = _first(open_capture(folder / "png"), counts[0]), api.load_scanner(folder / "calibration.json")
    runs = {"decode": decode_alone(capture), "whole": lambda: reconstruct(capture, scanner)}
    return {name: (times.best, times.processor) for name, times in take_turns(runs, repeats).items()}


def command(folder: Path, counts: list[int], repeats: int) -> dict[str, Any]:
    """`jaxscan reconstruct` of the whole packed capture: seconds of each stage, and the memory at its end."""
    # Where older trees have it, too.
    try:
        from jaxscan.cli.running import run_process
    except ModuleNotFoundError:
        from jaxscan.cli.process.running import run_process  # type: ignore[import-not-found,no-redef]

    del counts, repeats
    stages: dict[str, dict[str, float]] = {}

    def watched(function: Callable[..., Any], stage: str) -> Callable[..., Any]:
        def call(*arguments: Any, **keywords: Any) -> Any:
            start, used = time.perf_counter(), processor_s()
            result = function(*arguments, **keywords)
            spent = {"wall_s": time.perf_counter() - start, "processor_s": processor_s() - used}
            stages[stage] = spent | {"peak_bytes": peak_bytes()}
            return result

        return call

    for name, stage in STAGES.items():
        setattr(api, name, watched(getattr(api, name), stage))
    words = ["reconstruct", str(folder / "packed"), "-c", str(folder / "calibration.json"), "--no-cache"]
    out, sys.stdout = sys.stdout, sys.stderr
    code = run_process([*words, "-o", str(folder / "cloud.ply"), "--debug"])
    sys.stdout = out
    if code != 0:
        sys.exit(f"jaxscan reconstruct ended with exit code {code}.")
    return {"stages": stages, "processor_s": processor_s(), "peak_bytes": peak_bytes()}


def decode_alone(capture: Capture) -> Callable[[], object]:
    """Read and decode every image of a capture of files and drop it, on all cores."""
    size = capture.image_size
    names = [capture.path / ref.path for record in capture.records for ref in (*record.on, *record.off)]

    def one(path: Path) -> None:
        decode_image(path.read_bytes(), name=path.name, rank=2, size=size)

    def run() -> None:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for _ in pool.map(one, names):
                pass

    return run


def processor_s() -> float:
    """Processor time of this process and of those that it has waited for, from its start [s]."""
    return sum(os.times()[:4])


def peak_bytes() -> int:
    """Largest resident memory of this process [bytes]; unlike that of `getrusage` it is not that of the parent."""
    with open("/proc/self/status") as status:
        return 1024 * next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))


def _first(capture: Capture, count: int) -> Capture:
    return dataclasses.replace(capture, records=capture.records[:count])


def main() -> None:
    parser = command_line(__doc__)
    jobs = {"memory": memory, "cold": cold, "packed": packed, "png": png, "command": command}
    parser.add_argument("job", choices=jobs)
    parser.add_argument("folder", type=Path)
    parser.add_argument("counts", type=int, nargs="+")
    parser.add_argument("--repeats", type=int, default=1)
    options = parser.parse_args()
    code = str(Path(jaxscan.__file__).resolve())
    print(json.dumps({"code": code} | jobs[options.job](options.folder, options.counts, options.repeats)))


if __name__ == "__main__":
    main()
