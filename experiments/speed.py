"""Speed of a whole reconstruction beside other pipelines and the limits of the machine, in one run.

All contestants get the same stacks in memory and take turns. Ours and the other pipelines end in
coloured points. Ours also fits sub-pixel centres with their noise, chooses among several
reflections, and gives normals and two sigmas per point. "fused" is the least work for peak and
centroid, "read" the least for the bytes alone. Then whole sweeps from files: PNG against decoding
alone, shards of many pairs, other lengths, and clouds from known stripes. Then warm calibrations.
Compilation is not timed, except in the last section, the first result: the demo and a calibration
of its boards as commands, with nothing compiled and again. The frames come from `speed_scene.py`.

    python experiments/speed.py [--quick] [--only SECTION] [--scratch DIR] [--json FILE] [--results DIR]

Without --quick and --only the tables and the plot in experiments/results are written anew.
"""

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from measuring import speed_disk
from measuring.speed_calibration import calibration_figures
from measuring.speed_cold import cold_figures
from measuring.speed_memory import measure_memory, memory_figures, small_figures
from measuring.speed_stages import stages
from measuring.speed_times import Figure, Times, load, machine
from tables.speed_table import write_results
from worlds.speed_scene import (
    DISTINCT,
    make_frames,
    make_scanner,
)


SECTIONS = ("memory", "stages", "png", "shards", "calibration", "cold")
RESULTS = Path(__file__).resolve().parent / "results"


class Size(NamedTuple):
    """How much is measured."""

    pairs: int
    """In memory; far more than any cache holds."""
    repeats: int
    png_records: int
    shard_records: tuple[int, ...]
    shard_repeats: int


FULL = Size(512, 5, 512, (100, 400, 1200, 3600), 2)
QUICK = Size(48, 2, 24, (50, 100), 1)


def png_figures(folder: Path, size: Size) -> list[Figure]:
    """A capture of PNG files: decoding, and all of it."""
    found = speed_disk.measure_png(folder, min(size.repeats, 5))
    times, records = found["times"], found["records"]
    figures = [
        Figure("png_decode", 1e3 * times["decode"].best / records, "ms/pair", "lower", 0.2),
        Figure("png_chunks", 1e3 * times["chunks"].best / records, "ms/pair", "lower", 0.2),
        Figure("png_whole", 1e3 * times["whole"].best / records, "ms/pair", "lower", 0.2),
        Figure("png_whole_median", 1e3 * times["whole"].median / records, "ms/pair", "lower", 0.2),
    ]
    return [*figures, Figure("png whole / decode", times["whole"].best / times["decode"].best, "1", "lower", 0.1, 1.15)]


def shard_figures(folder: Path, size: Size) -> list[Figure]:
    """A long sweep of shards: seconds, memory, other lengths, and from known stripes."""
    counts = list(size.shard_records)
    found = speed_disk.measure_shards(folder, counts, size.shard_repeats)
    walls = {int(count): runs for count, runs in found["walls"].items()}
    most, full = max(counts), max(counts) == max(FULL.shard_records)
    chunks, again, cached = (Times(*found[key]) for key in ("chunks", "again", "cached"))
    figures = [
        Figure(f"shards {most} pairs, best", min(walls[most]), "s", "lower", 0.2, 10.0 if full else None),
        Figure(f"shards {most} pairs, median", float(np.median(walls[most])), "s", "lower", 0.2),
        Figure("shards_decode", 1e3 * chunks.best / most, "ms/pair", "lower", 0.3),
        Figure("shards_points", found["points"], "of lines", "higher", 0.02),
        Figure("shards peak memory without file pages", found["peak_bytes"] / 1e9, "GB", "lower", 0.1, 2.0),
    ]
    each = {count: 1e3 * min(walls[count]) / count for count in counts}
    figures += [Figure(f"shards_{count}_pairs", each[count], "ms/pair", "lower", 0.2) for count in counts]
    middle = float(np.median(list(each.values())))
    spread = max(abs(value / middle - 1.0) for value in each.values())
    figures.append(Figure("shards largest change of ms/pair with length", spread, "1", "lower", 0.5, 0.15))
    asked = 3.0 if full else None
    for name, times in (("stripes", again), ("kept stripes", cached)):
        figures.append(Figure(f"again from {name}, {most} pairs, best", times.best, "s", "lower", 0.2, asked))
        figures.append(Figure(f"again from {name}, {most} pairs, median", times.median, "s", "lower", 0.2))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few pairs: to see that it runs")
    parser.add_argument("--only", choices=SECTIONS, help="one section")
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="where captures go for a while: up to 10 GB")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file (- for standard output)")
    parser.add_argument("--results", type=Path, metavar="DIR", help="write tables and plot there")
    options = parser.parse_args()
    size = QUICK if options.quick else FULL
    sections = [options.only] if options.only else list(SECTIONS)
    about, scanner = machine(), make_scanner()
    rows, steps, figures = [], [], []
    if {"memory", "stages"} & set(sections):
        frames = make_frames(size.pairs, scanner)
        if "memory" in sections:
            rows = measure_memory(frames, size.repeats)
            figures += memory_figures(rows) + small_figures(frames, size.repeats)
        if "stages" in sections:
            steps = stages(frames, scanner, size.repeats)
            figures += [Figure(f"stage {step.name}", 1e3 * step.times.best, "ms/pair", "lower", 0.3) for step in steps]
        del frames
    for section, write, records, measure in (
        ("png", speed_disk.write_png_capture, size.png_records, png_figures),
        ("shards", speed_disk.write_shard_capture, max(size.shard_records), shard_figures),
    ):
        if section in sections:
            scratch = Path(tempfile.mkdtemp(prefix="jaxscan-speed-", dir=options.scratch))
            try:
                write(scratch / section, make_frames(DISTINCT, scanner), records)
                figures += measure(scratch / section, size)
            finally:
                shutil.rmtree(scratch)
    if "calibration" in sections:
        figures += calibration_figures(size.repeats)
    if "cold" in sections and not (options.quick and options.only != "cold"):
        with tempfile.TemporaryDirectory(prefix="jaxscan-speed-", dir=options.scratch) as scratch:
            figures += cold_figures(Path(scratch))
    about |= {"load_at_end": load()}
    for figure in figures:
        verdict = {None: "", True: f"asked {figure.asked}: met", False: f"asked {figure.asked}: MISSED"}[figure.met()]
        print(f"{figure.key:>48} {figure.value:10.3f} {figure.unit:8} {verdict}", file=sys.stderr)
    results = options.results or (None if options.quick or options.only else RESULTS)
    if results is not None:
        write_results(results, about, rows, steps, figures, size.pairs)
    if options.json:
        document = {"format": "jaxscan-experiment-speed/1", "quick": options.quick, **about}
        text = json.dumps(document | {"metrics": [figure._asdict() for figure in figures]}, indent=1) + "\n"
        if options.json == "-":
            print(text, end="")
        else:
            Path(options.json).write_text(text)


if __name__ == "__main__":
    main()
