"""Speed of a whole reconstruction beside other pipelines and the limits of the machine, in one run.

All contestants get the same stacks in memory and take turns. Ours and the other pipelines end in
coloured points. Ours also fits sub-pixel centres with their noise, chooses among several
reflections, and gives normals and two sigmas per point. "fused" is the least work for peak and
centroid, "read" the least for the bytes alone. Then whole sweeps from files: PNG against decoding
alone, shards of many pairs, other lengths, and clouds from known stripes. Compilation is not
timed. The frames come from `speed_scene.py`.

    python experiments/speed.py [--quick] [--only memory|stages|png|shards] [--scratch DIR]
                                [--json FILE] [--results DIR]

Without --quick and --only the tables and the plot in experiments/results are written anew.
"""

import argparse
import dataclasses
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from measuring import speed_disk
from measuring import speed_peers as peers
from measuring.speed_stages import stages
from measuring.speed_times import Contestant, Figure, Times, load, machine, take_turns
from tables.speed_table import write_results
from worlds.speed_scene import (
    DISTINCT,
    ELECTRONS_PER_DN,
    HEIGHT,
    READ_DN,
    WIDTH,
    Frames,
    make_angles,
    make_frames,
    make_scanner,
)

from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import NoiseModel, StripeSettings, extract_stripes


PLAIN = StripeSettings(estimator="centre_of_gravity")
"""The plain estimator, beside the default one."""
SECTIONS = ("memory", "stages", "png", "shards")
RESULTS = Path(__file__).resolve().parent / "results"
PAIR_BYTES = 2 * WIDTH * HEIGHT


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


def own_variants() -> dict[str, dict[str, Any]]:
    """Ours as it comes and in variants: keywords of `reconstruct`."""
    noise = NoiseModel(READ_DN, ELECTRONS_PER_DN)
    variants: dict[str, dict[str, Any]] = {
        "ours": {},
        "ours, noise given": {"noise": noise},
        "ours, centre of gravity": {"noise": noise, "settings": ReconstructSettings(stripes=PLAIN)},
        "ours, no normals": {"noise": noise, "settings": ReconstructSettings(normals=False)},
    }
    # The columns where the calibrated rig can see a stripe are a part of the image; this is all of it.
    if "gate" in {field.name for field in dataclasses.fields(ReconstructSettings)}:
        everywhere: dict[str, Any] = {"gate": False}
        variants["ours, all columns"] = {"noise": noise, "settings": ReconstructSettings(**everywhere)}
    return variants


def measure_memory(frames: Frames, size: Size) -> list[Contestant]:
    """Whole pipelines and bounds on stacks in memory."""
    scanner, angle = make_scanner(), make_angles(size.pairs)
    sweep = Sweep(frames.on, frames.off, angle)
    # OpenCV's own threads would only compete with the threads over frames.
    cv2.setNumThreads(1)
    with ThreadPoolExecutor(peers.THREADS) as pool:
        stacks = (frames.on, frames.off)
        others = {
            "horus": peers.horus(scanner, *stacks, angle, pool),
            "usual": peers.pipeline(peers.usual_centres, scanner, *stacks, angle, pool),
            "lean": peers.pipeline(peers.lean_centres, scanner, *stacks, angle, pool),
            "fused": peers.fused(*stacks, pool),
        }
        points: dict[str, float] = {}

        def own(name: str, options: dict[str, Any]) -> Callable[[], object]:
            def run() -> None:
                points[name] = float(reconstruct(sweep, scanner, **options).valid.mean())

            return run

        runs = {name: own(name, options) for name, options in own_variants().items()}
        runs |= {name: peer.run for name, peer in others.items()} | {"read": peers.read(*stacks, pool)}
        times = take_turns(runs, size.repeats)
    right: dict[str, float | None] = {name: _right(peer.u, frames) for name, peer in others.items()}
    found = extract_stripes(*(stack[:DISTINCT] for stack in stacks))
    right["ours"] = _right(np.where(found.valid, found.u, np.nan), frames)
    plain = extract_stripes(*(stack[:DISTINCT] for stack in stacks), settings=PLAIN)
    right["ours, centre of gravity"] = _right(np.where(plain.valid, plain.u, np.nan), frames)
    for name in ("horus", "usual", "lean"):
        points[name] = float(np.isfinite(others[name].u).mean())
    gives = {
        "ours": "points, colours, normals, two sigmas; the noise of the frames, once",
        "ours, noise given": "points, colours, normals, two sigmas",
        "ours, no normals": "noise given; points, colours, two sigmas",
        "ours, all columns": "noise given; stripes searched in every column",
        "ours, centre of gravity": "noise given; the plain estimator instead of the fit",
        "horus": "the desk scanner, operation by operation: points, colours",
        "usual": "the same for all rows at once: points, colours",
        "lean": "the least that gives a centroid: points, colours",
        "fused": "bound: peak and centroid in one native pass",
        "read": "bound: the bytes",
    }
    return [
        Contestant(name, gives[name], Times(*(t / size.pairs for t in times[name])), points.get(name), right.get(name))
        for name in runs
    ]


def _right(u: np.ndarray, frames: Frames) -> float:
    """Share of the stripes drawn whose centre was found within 1 px, among the distinct pairs."""
    first = slice(0, min(DISTINCT, len(u)))
    close = np.abs(np.nan_to_num(u[first], nan=-1e6) - frames.u[first]) < 1.0
    return float(close[frames.lit[first]].mean())


def memory_figures(rows: list[Contestant]) -> list[Figure]:
    """Times per pair, and their ratios, each of the best runs."""
    times = {row.name: row.times for row in rows}
    figures = []
    for row in rows:
        key = row.name.replace(", ", "_").replace(" ", "_")
        figures.append(Figure(f"{key}_wall", 1e3 * row.times.best, "ms/pair", "lower", 0.3))
        figures.append(Figure(f"{key}_cpu", 1e3 * row.times.processor, "ms/pair", "lower", 0.2))
        if row.points is not None:
            figures.append(Figure(f"{key}_points", row.points, "of lines", "higher", 0.02))
    ratios: list[tuple[str, str, str, float | None]] = [
        ("ours", "fused", "lower", 8.0),
        ("ours, noise given", "fused", "lower", None),
        ("ours", "read", "lower", None),
        ("horus", "ours", "higher", 2.0),
        ("usual", "ours", "higher", None),
        ("lean", "ours", "higher", None),
        ("horus", "ours, no normals", "higher", None),
        ("usual", "ours, no normals", "higher", None),
        ("lean", "ours, no normals", "higher", None),
        ("fused", "read", "lower", None),
    ]
    for over, under, direction, asked in ratios:
        ratio = times[over].best / times[under].best
        figures.append(Figure(f"{over} / {under}", ratio, "1", direction, 0.3, asked))
    figures.append(Figure("bandwidth", PAIR_BYTES / times["read"].best / 1e9, "GB/s", "higher", 0.5))
    return figures


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
    figures.append(Figure("shards largest change of ms/pair with length", spread, "1", "lower", 0.5, 0.1))
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
            rows = measure_memory(frames, size)
            figures += memory_figures(rows)
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
