"""Speed of a whole reconstruction beside other pipelines and the limits of the machine, in one run.

All contestants get the same stacks in memory and take turns. Ours and the other pipelines end in
coloured points. Ours also fits sub-pixel centres with their noise, chooses among several
reflections, and gives normals and two sigmas per point. "fused" is the least work for peak and
centroid, "read" the least for the bytes alone. Then whole sweeps from files: PNG against decoding
alone, many pairs as new captures store them and as shards, other lengths, and clouds from known
stripes. Then lossless codecs, and warm calibrations.
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
from measuring.speed_codecs import CodecRow, measure_codecs
from measuring.speed_cold import cold_figures
from measuring.speed_memory import measure_memory, memory_figures, small_figures
from measuring.speed_stages import stages
from measuring.speed_times import Figure, Times, load, machine
from tables.speed_table import Found, write_results
from worlds.speed_scene import (
    DISTINCT,
    make_frames,
    make_scanner,
)


SECTIONS = ("memory", "stages", "png", "packed", "shards", "codecs", "calibration", "cold")
CODEC_FRAMES = 8
"""Pairs on which codecs are compared."""
RESULTS = Path(__file__).resolve().parent / "results"


class Size(NamedTuple):
    """How much is measured."""

    pairs: int
    """In memory; far more than any cache holds."""
    repeats: int
    png_records: int
    stored_records: tuple[int, ...]
    """Of the captures as new ones are stored, and of the shards."""
    stored_repeats: int


STORED_LIMITS = {"packed": (6.0, 1.5), "shards": (10.0, 2.0)}
"""Of the longest sweep: seconds, and memory without the pages of files [GB]."""
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
    return [*figures, Figure("png whole / decode", times["whole"].best / times["decode"].best, "1", "lower", 0.1, 1.1)]


def stored_figures(folder: Path, size: Size) -> list[Figure]:
    """A long sweep from files, in the storage that the folder is named after: seconds, memory, other lengths, and from
    known stripes."""
    name, counts = folder.name, list(size.stored_records)
    found = speed_disk.measure_stored(folder, counts, size.stored_repeats)
    walls = {int(count): runs for count, runs in found["walls"].items()}
    most, full = max(counts), max(counts) == max(FULL.stored_records)
    seconds, gigabytes = STORED_LIMITS[name]
    chunks, again, cached = (Times(*found[key]) for key in ("chunks", "again", "cached"))
    figures = [
        Figure(f"{name} {most} pairs, best", min(walls[most]), "s", "lower", 0.2, seconds if full else None),
        Figure(f"{name} {most} pairs, median", float(np.median(walls[most])), "s", "lower", 0.2),
        Figure(f"{name}_decode", 1e3 * chunks.best / most, "ms/pair", "lower", 0.3),
        Figure(f"{name}_points", found["points"], "of lines", "higher", 0.02),
        Figure(f"{name} peak memory without file pages", found["peak_bytes"] / 1e9, "GB", "lower", 0.1, gigabytes),
    ]
    each = {count: 1e3 * min(walls[count]) / count for count in counts}
    figures += [Figure(f"{name}_{count}_pairs", each[count], "ms/pair", "lower", 0.2) for count in counts]
    middle = float(np.median(list(each.values())))
    spread = max(abs(value / middle - 1.0) for value in each.values())
    figures.append(Figure(f"{name} largest change of ms/pair with length", spread, "1", "lower", 0.5, 0.15))
    asked = 3.0 if full else None
    for kind, times in (("stripes", again), ("kept stripes", cached)):
        figures.append(Figure(f"{name}: again from {kind}, {most} pairs, best", times.best, "s", "lower", 0.2, asked))
        figures.append(Figure(f"{name}: again from {kind}, {most} pairs, median", times.median, "s", "lower", 0.2))
    return figures


def codec_figures(rows: list[CodecRow]) -> list[Figure]:
    """The storage of new captures beside PNG, by the laser-on frames."""
    on = {row.codec: row for row in rows if row.frames == "on"}
    ours, png = on["zstd of rows' differences"], on["PNG"]
    return [
        Figure("new store: decode rate / PNG's", png.decode / ours.decode, "1", "higher", 0.2, 5.0),
        Figure("new store: size / PNG's", ours.size / png.size, "1", "lower", 0.05, 1.3),
    ]


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
    rows, steps, codecs, figures = [], [], [], []
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
        ("packed", speed_disk.write_packed_capture, max(size.stored_records), stored_figures),
        ("shards", speed_disk.write_shard_capture, max(size.stored_records), stored_figures),
    ):
        if section in sections:
            scratch = Path(tempfile.mkdtemp(prefix="jaxscan-speed-", dir=options.scratch))
            try:
                write(scratch / section, make_frames(DISTINCT, scanner), records)
                figures += measure(scratch / section, size)
            finally:
                shutil.rmtree(scratch)
    if "codecs" in sections:
        codecs = measure_codecs(make_frames(CODEC_FRAMES, scanner), repeats=size.repeats)
        figures += codec_figures(codecs)
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
        write_results(results, about, Found(rows, steps, codecs, figures), size.pairs)
    if options.json:
        document = {"format": "jaxscan-experiment-speed/1", "quick": options.quick, **about}
        text = json.dumps(document | {"metrics": [figure._asdict() for figure in figures]}, indent=1) + "\n"
        if options.json == "-":
            print(text, end="")
        else:
            Path(options.json).write_text(text)


if __name__ == "__main__":
    main()
