"""Speed of this tree's reconstruction against that of another tree, on the same frames of the same machine.

Each measurement runs in a process of its own (`measuring/tree_jobs.py`), in turn with the other tree's: first that one,
then ours, round after round. The least of several rounds counts; the ratio is ours over the other's, with the least and
the largest ratio of neighbouring runs. On a busy machine processor time tells more than wall time.

- memory: 64 and 512 pairs in memory, smoothed, the noise learned; and what a sweep costs whatever its length;
- cold: the first reconstruction of 64 pairs from files, nothing compiled: programs and time, imports included;
- packed: 3600 pairs as new captures store them, and the process's largest resident memory;
- png: PNG files, beside decoding alone;
- command: `jaxscan reconstruct` of the 3600 pairs to a PLY file, with the colours of photographs; nothing is compiled
  or cached before.

The frames are those of `speed_scene.py`, 32 different pairs again and again. The other tree is a checkout that this
environment can run; without one ours is measured alone.

    python experiments/speed_against.py [--against TREE] [--only PART …] [--rounds N] [--quick] [--scratch DIR]
                                        [--json FILE]
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measuring.speed_disk import write_packed_capture, write_png_capture
from measuring.speed_times import load, machine
from report import command_line, write_json
from worlds.speed_scene import DISTINCT, make_frames, make_scanner

from jaxscan import api


OWN = Path(__file__).resolve().parents[1]
PARTS = ("memory", "cold", "packed", "png", "command")
COMMAND_LIMITS = {"command, wall": 25.0, "command, peak memory": 1.5}
"""Asked of the command on a quiet machine with two cores [s, GB]."""


class Size(NamedTuple):
    """Numbers of pairs."""

    memory: tuple[int, int]
    cold: int
    packed: int
    png: int
    repeats: int
    """Runs in each process, after the one that compiles."""


FULL = Size((64, 512), 64, 3600, 256, 3)
QUICK = Size((16, 64), 16, 96, 32, 1)


class Row(NamedTuple):
    """A quantity of both trees."""

    key: str
    unit: str
    other: list[float]
    """In the order of the rounds; empty without another tree."""
    own: list[float]

    def line(self) -> str:
        """A row of the table."""
        best = [f"{min(values):.4g}" if values else "" for values in (self.other, self.own)]
        ratio, limit = "", COMMAND_LIMITS.get(self.key)
        if self.other and min(self.other) > 0:
            each = [own / other for own, other in zip(self.own, self.other, strict=True)]
            among = f" ({min(each):.3f} to {max(each):.3f})" if len(each) > 1 else ""
            ratio = f"{min(self.own) / min(self.other):.3f}{among}"
        asked = "" if limit is None else f"≤ {limit:g}: {'met' if min(self.own) <= limit else 'MISSED'}"
        return f"| {self.key} | {self.unit} | {best[0]} | {best[1]} | {ratio} | {asked} |"


def run(tree: Path, scratch: Path, *words: str | int) -> dict[str, Any]:
    """The result of one job by one tree's code; what it compiles is kept nowhere."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "NUMBA_"))}
    with tempfile.TemporaryDirectory(dir=scratch) as cache:
        environment |= {
            "PYTHONPATH": os.pathsep.join([str(tree), str(tree / "hardware")]),
            "XDG_CACHE_HOME": cache,
            "NUMBA_CACHE_DIR": cache,
            "OPENBLAS_NUM_THREADS": "1",
        }
        command = [sys.executable, "-m", "measuring.tree_jobs", *map(str, words)]
        start = time.perf_counter()
        done = subprocess.run(
            command, cwd=OWN / "experiments", env=environment, capture_output=True, text=True, check=False
        )
        wall = time.perf_counter() - start
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}, with the code of {tree}: exit code {done.returncode}\n{done.stderr[-2000:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    assert Path(found["code"]).is_relative_to(tree), found["code"]
    return found | {"process_wall_s": wall}


def figures(part: str, found: dict[str, Any], size: Size) -> dict[tuple[str, str], float]:
    """What a job found, by name and unit."""
    if part == "memory":
        out, pairs = {}, size.memory
        for k, kind in enumerate(("wall", "processor")):
            few, many = (found[str(count)][k] for count in pairs)
            each = (many - few) / (pairs[1] - pairs[0])
            out |= {
                (f"{pairs[1]} pairs in memory, {kind}", "ms/pair"): 1e3 * many / pairs[1],
                (f"{pairs[0]} pairs in memory, {kind}", "ms/pair"): 1e3 * few / pairs[0],
                (f"every further pair, {kind}", "ms"): 1e3 * each,
                (f"a sweep of no pair, {kind}", "ms"): 1e3 * (few - each * pairs[0]),
            }
        return out
    if part == "png":
        (decode, decode_used), (whole, used) = found["decode"], found["whole"]
        return {
            ("PNG, decoding alone, wall", "ms/pair"): 1e3 * decode / size.png,
            ("PNG, whole, wall", "ms/pair"): 1e3 * whole / size.png,
            ("PNG, whole, processor", "ms/pair"): 1e3 * used / size.png,
            ("PNG, whole over decoding, wall", "1"): whole / decode,
            ("PNG, whole over decoding, processor", "1"): used / decode_used,
        }
    name = {"cold": f"cold, {size.cold} pairs", "packed": f"{size.packed} packed pairs", "command": "command"}[part]
    wall = found["wall_s"] if part == "packed" else found["process_wall_s"]
    out = {(f"{name}, wall", "s"): wall, (f"{name}, processor", "s"): found["processor_s"]}
    if part == "cold":
        return out | {
            (f"{name}, programs", "1"): found["programs"],
            (f"{name}, in XLA's compiler", "s"): found["compiling_s"],
        }
    out |= {(f"{name}, peak memory", "GB"): found["peak_bytes"] / 1e9}
    for stage, about in found.get("stages", {}).items():
        out |= {
            (f"command, {stage}, wall", "s"): about["wall_s"],
            (f"command, {stage}, processor", "s"): about["processor_s"],
            (f"command, peak memory after {stage}", "GB"): about["peak_bytes"] / 1e9,
        }
    return out


def write_scene(folder: Path, parts: list[str], size: Size) -> None:
    """Frames, scanner and captures for the jobs."""
    scanner = make_scanner()
    frames = make_frames(DISTINCT, scanner)
    for kind in ("on", "off"):
        np.save(folder / f"{kind}.npy", getattr(frames, kind))
    calibration = api.Calibration(scanner.camera, scanner, (), np.zeros((0, 0)))
    api.save_calibration(calibration, folder / "calibration.json")
    if {"cold", "packed", "command"} & set(parts):
        long = {"packed", "command"} & set(parts)
        write_packed_capture(folder / "packed", frames, size.packed if long else size.cold)
    if "png" in parts:
        write_png_capture(folder / "png", frames, size.png)


def main() -> int:
    parser = command_line(__doc__, quick="few pairs: to see that it runs", json=True)
    parser.add_argument("--against", type=Path, metavar="TREE", help="sources of another version")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=PARTS, help="some parts")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="where captures go for a while: up to 10 GB")
    options = parser.parse_args()
    size, parts = QUICK if options.quick else FULL, list(options.only)
    trees = [OWN] if options.against is None else [options.against.resolve(), OWN]
    about = machine()
    rows: dict[tuple[str, str], Row] = {}
    scratch = Path(tempfile.mkdtemp(prefix="jaxscan-speed-", dir=options.scratch))
    try:
        write_scene(scratch, parts, size)
        for part in parts:
            counts = {"memory": size.memory, "command": (size.packed,)}.get(part) or (getattr(size, part),)
            repeats = 1 if part == "packed" else size.repeats
            for turn in range(options.rounds):
                for tree in trees:
                    found = run(tree, scratch, part, scratch, *counts, "--repeats", repeats)
                    for (key, unit), value in figures(part, found, size).items():
                        row = rows.setdefault((key, unit), Row(key, unit, [], []))
                        (row.own if tree == OWN else row.other).append(value)
                print(f"{part}, round {turn + 1} of {options.rounds}", file=sys.stderr)
                # What is cut off in a later part leaves these.
                print(*(row.line() for row in rows.values()), sep="\n", file=sys.stderr, flush=True)
    finally:
        shutil.rmtree(scratch)
    about |= {"load_at_end": load()}
    print(*(f"{key}: {value}" for key, value in about.items()), sep="\n")
    print("", "| figure | unit | other | ours | ours / other | asked |", "|---|---|---:|---:|---:|---|", sep="\n")
    print(*(row.line() for row in rows.values()), sep="\n")
    document = {"format": "jaxscan-experiment-speed-against/1", "quick": options.quick, **about}
    write_json(options.json, document | {"figures": [row._asdict() for row in rows.values()]})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
