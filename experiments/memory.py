"""Memory of a reconstruction: only the cloud may grow with the length of the sweep.

Each sweep is reconstructed at n, 2n and 4n records, each in a separate process that reads its
anonymous memory (`RssAnon` in /proc/self/status) every five milliseconds and reports the largest
value. This includes JAX, the compiled code and the compiler, but not pages of mapped files, which
the system drops when it needs room.

The compiler's memory varies between runs by more than a cloud. So the process reconstructs the
sweep once, returns free memory, and reconstructs it again. "needed" is the peak above the memory
left before: the least of three passes, because the number of waiting chunks varies. "growth" is
the additional memory of 2n and 4n records over n, per cell of the cloud's grid. For this the
chunks are so small that the largest number of waiting chunks is reached at n records. With chunks
of the default size only the peak is checked. The frames are synthetic stripes on noise.

    python experiments/memory.py [--quick] [--json FILE]
"""

import argparse
import ctypes
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measuring.speed_times import Watch, anonymous_bytes
from report import command_line, write_json

from jaxscan.files.capture import open_capture
from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.reconstruction import ReconstructSettings, reconstruct
from jaxscan.vision import encode_png


LIMIT_BYTES = 2e9
"""Most that any of these sweeps may take."""
GROWTH_BYTES = 60.0
"""Most that a cell of the grid may take: 40 for the cloud's fields, the rest for its records."""
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_ARENA_MAX": "2"}
"""Arrays are mapped one by one and unmapped when they are free, so that resident memory is used memory."""
PASSES = 3
DISTINCT = 8
"""Different pairs of frames."""


class Case(NamedTuple):
    """A sweep that is reconstructed at n, 2n and 4n records."""

    name: str
    width: int
    height: int
    records: int
    """4n."""
    shards: bool
    """Frames in .npy shards, or in PNG files."""
    chunk_records: int | None
    """Few enough that all chunks that are ever in flight are so at n records already; None: the
    default, for the peak at 4n records alone."""


CASES = (
    Case("small, shards", 160, 128, 3600, True, 32),
    Case("small, PNG", 160, 128, 3600, False, 32),
    Case("large, PNG", 1280, 1024, 400, False, 4),
    Case("large, default", 1280, 1024, 400, False, None),
)
QUICK = (
    Case("small, shards", 160, 128, 1200, True, 32),
    Case("large, PNG", 1280, 1024, 120, False, 1),
    Case("large, default", 1280, 1024, 120, False, None),
)


def make_scanner(width: int, height: int) -> Scanner:
    """A rig that sees a wall at about 1.4 m where the stripe is."""
    f, cx, cy = (np.float64(value) for value in (1.2 * width, (width - 1) / 2, (height - 1) / 2))
    camera = Pinhole(f, f, cx, cy, np.array([-0.1, 0.05, 0.0, 0.0, 0.0]), width=width, height=height)
    sheet = LaserSheet.from_plane(np.array([0.99, 0.0, 0.14]), 0.2)
    return Scanner(camera, stack_lasers([sheet]), Turntable.from_axis([0.01, -1.0, 0.01], [0.02, 0.0, -0.15]))


def make_frames(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a stripe on a lit wall with noise, uint8 [DISTINCT, height, width]."""
    random = np.random.default_rng(0)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    on, off = (np.empty((DISTINCT, height, width), np.uint8) for _ in range(2))
    room = 40.0 + 20.0 * np.sin(9.0 * columns / width) * np.cos(7.0 * rows / height)
    for number in range(DISTINCT):
        centre = 0.5 * width + 0.05 * width * np.sin(5.0 * rows[:, :1] / height + number)
        for stack, light in ((on, room + 110.0 * np.exp(-0.5 * ((columns - centre) / 1.9) ** 2)), (off, room)):
            noise = np.sqrt(1.0 + light / 40.0) * random.standard_normal(light.shape, np.float32)
            stack[number] = np.clip(np.round(light + noise), 0, 255)
    return on, off


def write_capture(folder: Path, case: Case, records: int) -> None:
    """A sweep of so many records; PNG files are named by several of them, shards hold a frame each."""
    folder.mkdir()
    header = f'format = "jaxscan-capture/1"\nkind = "sweep"\n[camera]\nwidth = {case.width}\nheight = {case.height}\n'
    (folder / "capture.toml").write_text(header + 'pixel_format = "mono8"\n[laser]\nname = "laser"\n')
    pairs = dict(zip(("on", "off"), make_frames(case.width, case.height), strict=True))
    for kind, frames in pairs.items():
        if case.shards:
            shape = (records, case.height, case.width)
            shard = np.lib.format.open_memmap(folder / f"{kind}.npy", mode="w+", dtype=np.uint8, shape=shape)
            for start in range(0, records, DISTINCT):
                shard[start : start + DISTINCT] = frames[: records - start]
            shard.flush()
        else:
            for number, frame in enumerate(frames):
                (folder / f"{kind}{number}.png").write_bytes(encode_png(frame))
    with open(folder / "frames.jsonl", "w") as journal:
        for i in range(records):
            images = {kind: f"{kind}.npy#{i}" if case.shards else f"{kind}{i % DISTINCT}.png" for kind in pairs}
            journal.write(json.dumps({"i": i, "angle_deg": 360.0 * i / records, **images}) + "\n")


def child(folder: Path, chunk_records: int | None) -> None:
    """Reconstruct a capture a few times and print memory and time."""
    settings = ReconstructSettings(chunk_records=chunk_records)
    with Watch() as compiling:
        sweep = open_capture(folder)
        scanner = make_scanner(*sweep.image_size)
        reconstruct(sweep, scanner, settings=settings)
    peak, needed, seconds = compiling.peak, [], []
    for _ in range(PASSES):
        cloud = None
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        before = anonymous_bytes()
        with Watch() as watch:
            start = time.perf_counter()
            cloud = reconstruct(sweep, scanner, settings=settings)
            seconds.append(time.perf_counter() - start)
        peak = max(peak, watch.peak)
        needed.append(watch.peak - before)
    fields = (cloud.xyz, cloud.rgb, cloud.intensity, cloud.normals)
    fields += (cloud.sigma_random, cloud.sigma_systematic, cloud.valid)
    found = {
        "peak_bytes": peak,
        "needed_bytes": min(needed),
        "cells": int(cloud.valid.size),
        "points": int(cloud.valid.sum()),
        "cloud_bytes": sum(field.nbytes for field in fields),
        "seconds_s": min(seconds),
    }
    print(json.dumps(found))


def measure(case: Case) -> list[dict[str, Any]]:
    """Peaks at n, 2n and 4n records, or at 4n alone."""
    found = []
    for records in (case.records // 4, case.records // 2, case.records)[0 if case.chunk_records else 2 :]:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / "sweep"
            write_capture(folder, case, records)
            words = [sys.executable, __file__, "--child", str(folder)]
            words += [] if case.chunk_records is None else ["--chunk-records", str(case.chunk_records)]
            run = subprocess.run(words, stdout=subprocess.PIPE, check=True, env={**os.environ, **ALLOCATOR})
        found.append({"records": records, **json.loads(run.stdout)})
    return found


def main() -> int:
    """Print a table and the verdict; exit code 1 if memory is above its limit."""
    parser = command_line(__doc__, quick="fewer records", json=True)
    parser.add_argument("--child", metavar="CAPTURE", help=argparse.SUPPRESS)
    parser.add_argument("--chunk-records", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(Path(options.child), options.chunk_records)
        return 0
    metrics: list[dict[str, Any]] = []
    print(f"{'sweep':16} {'records':>8} {'peak MB':>8} {'needed MB':>9} {'cloud MB':>9} {'s':>6} {'bytes/cell':>11}")
    for case in QUICK if options.quick else CASES:
        found = measure(case)
        first, last = found[0], found[-1]
        for one in found:
            cells = one["cells"] - first["cells"]
            growth = f"{(one['needed_bytes'] - first['needed_bytes']) / cells:11.1f}" if cells else ""
            peak, needed, cloud = (one[key] / 1e6 for key in ("peak_bytes", "needed_bytes", "cloud_bytes"))
            line = f"{case.name:16} {one['records']:8} {peak:8.0f} {needed:9.1f} {cloud:9.1f}"
            print(f"{line} {one['seconds_s']:6.1f} {growth}")
        key = f"memory.{case.name}"
        metrics.append({"key": f"{key}.peak", "value": last["peak_bytes"], "unit": "bytes", "limit": LIMIT_BYTES})
        if last is not first:
            growth = last["needed_bytes"] - first["needed_bytes"]
            slope = growth / (last["cells"] - first["cells"])
            metrics.append({"key": f"{key}.growth", "value": slope, "unit": "bytes per cell", "limit": GROWTH_BYTES})
    failed = [metric for metric in metrics if metric["value"] > metric["limit"]]
    for metric in failed:
        print(f"too much: {metric['key']} = {metric['value']:.4g} {metric['unit']}, at most {metric['limit']:.4g}")
    write_json(options.json, {"format": "jaxscan-experiment-memory/1", "metrics": metrics})
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
