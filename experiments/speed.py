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

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import jax
import numpy as np
from matplotlib.figure import Figure as Picture
from measuring import speed_disk
from measuring.speed_disk import CodecRow, measure_codecs
from measuring.speed_memory import measure_memory, memory_figures, small_figures
from measuring.speed_times import Contestant, Figure, Times, load, machine, take_turns
from report import command_line, table, write_json
from worlds import exact_rig
from worlds.exact_rig import PosePlan, add_noise, draw_poses, ideal_boards
from worlds.speed_scene import (
    DISTINCT,
    make_frames,
    make_scanner,
)

from jaxscan.calibration import Calibration, CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.observation import Observations


VIEWS, POINTS, CAMERA_VIEWS = 40, 1000, 23
FEWER_VIEWS = 37
"""Of a second calibration in the same process, which should compile nothing."""
COMPILING = "/jax/core/compile/backend_compile_duration"


def calibration_figures(repeats: int) -> list[Figure]:
    """Warm times, and the time of compiling for another number of views."""
    rig, fewer = _rig(VIEWS), _rig(FEWER_VIEWS)
    plain = CalibrationSettings(judge=False)
    first = time.perf_counter()
    calibrate_observations(rig)
    first = time.perf_counter() - first
    compiled: list[float] = []

    def listen(event: str, duration: float, **_: object) -> None:
        if event == COMPILING:
            compiled.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    calibrate_observations(fewer)
    others, seconds = len(compiled), sum(compiled)
    ours, theirs = camera_contest()
    times = take_turns(
        {
            "plain": lambda: calibrate_observations(rig, settings=plain),
            "judged": lambda: calibrate_observations(rig),
            "ours": ours,
            "opencv": theirs,
        },
        repeats,
    )
    return [
        Figure("calibrate_observations, 40 views, first call", first, "s", "lower", 0.3),
        Figure("calibrate_observations, 40 views, warm", times["plain"].best, "s", "lower", 0.2, 0.4),
        Figure("calibrate_observations, 40 views, models judged", times["judged"].best, "s", "lower", 0.2),
        Figure(f"functions compiled for {FEWER_VIEWS} views after {VIEWS}", others, "", "lower", 0.0, 0.0),
        Figure("time of compiling these", seconds, "s", "lower", 0.3),
        Figure("camera alone", 1e3 * times["ours"].best, "ms", "lower", 0.2),
        Figure("camera alone / OpenCV", times["ours"].best / times["opencv"].best, "1", "lower", 0.2, 1.0),
    ]


def camera_contest() -> tuple[Callable[[], Calibration], Callable[[], Any]]:
    """The camera from the same 23 views by ours, with seed, covariance and rejection, and by OpenCV's."""
    config = exact_rig.reference()
    poses = draw_poses(config, 5, PosePlan(free_views=CAMERA_VIEWS, placements=0, angles=1, lit=0))
    observed = exact_rig.observations(add_noise(ideal_boards(config, poses), np.random.default_rng(0)), config)
    points = [observed.board.corners().astype(np.float32)] * CAMERA_VIEWS
    pixels = [q.astype(np.float32) for q in observed.corners.q]
    size = (config.camera.width, config.camera.height)
    plain = CalibrationSettings(judge=False)
    return (
        lambda: calibrate_camera(observed, settings=plain),
        lambda: cv2.calibrateCamera(points, pixels, size, None, None),
    )


def _rig(views: int) -> Observations:
    """All views of a rig, with the noise of a detector."""
    config = exact_rig.reference()
    poses = draw_poses(config, 3, PosePlan(free_views=views - 9, placements=3, angles=3))
    noisy = add_noise(ideal_boards(config, poses, points=POINTS), np.random.default_rng(0))
    return exact_rig.observations(noisy, config)


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


class Found(NamedTuple):
    """All that was measured; empty lists where a section was left out."""

    rows: list[Contestant]
    codecs: list[CodecRow]
    figures: list[Figure]


def write_results(folder: Path, about: dict[str, str], found: Found, pairs: int) -> None:
    """`speed.md`, `speed.json` and `speed.png`."""
    rows, codecs, figures = found
    folder.mkdir(exist_ok=True)
    parts = [_head(about, pairs), _asked(figures)]
    if rows:
        parts.append(_contestants(rows))
    if codecs:
        parts.append(_codecs(codecs))
    parts.append(_rest(figures))
    (folder / "speed.md").write_text("\n".join(parts))
    document = {"format": "jaxscan-experiment-speed/1", **about, "metrics": [figure._asdict() for figure in figures]}
    write_json(folder / "speed.json", document)
    if rows:
        bars = [(row.name, 1e3 * row.times.best) for row in rows]
        draw(folder / "speed.png", bars)


def _head(about: dict[str, str], pairs: int) -> str:
    return f"""# Speed of a reconstruction

Written by `python experiments/speed.py`; {about["date"]}.

- Processor: {about["processor"]}; load average {about["load"]} at the start, {about["load_at_end"]} at the end
- {about["versions"]}
- Frames: 1280 x 1024, 8 bit, on and off, a room with texture, noise, depth steps, stripes of 20 to 200 DN,
  rows without a stripe and rows with two; {pairs} pairs in memory, the same for all, contestants in turn
- Best run of several, and the median; compilation excluded
"""


def _asked(figures: list[Figure]) -> str:
    lines = []
    for figure in figures:
        if figure.asked is not None:
            sign = "<=" if figure.direction == "lower" else ">="
            unit = "" if figure.unit == "1" else f" {figure.unit}"
            verdict = "yes" if figure.met() else "**no**"
            lines.append([figure.key, f"{figure.value:.3g}{unit}", f"{sign} {figure.asked:g}{unit}", verdict])
    return "## Limits\n\n" + table(["figure", "found", "limit", "met"], lines) + "\n"


def _contestants(rows: list[Contestant]) -> str:
    own = next(row.times.best for row in rows if row.name == "ours")
    lines = []
    for row in rows:
        shares = ["" if share is None else f"{100 * share:.1f} %" for share in (row.points, row.right)]
        times = [f"{1e3 * t:.3f}" for t in row.times]
        lines.append([row.name, row.gives, *times, f"{row.times.best / own:.2f}", *shares])
    head = ["", "gives", "best, ms/pair", "median", "processor", "over ours", "lines with a point", "stripes found"]
    text = """## From frames in memory

"Processor" is the time of both cores together. "Lines with a point" counts all lines of all pairs, points on
reflections too; "stripes found" are the stripes drawn whose centre was found within 1 px.

"""
    return text + table(head, lines) + "\n"


def _codecs(codecs: list[CodecRow]) -> str:
    lines = []
    for row in codecs:
        times = [f"{1e3 * t:.2f}" for t in (row.encode, row.decode, row.decode_all_cores)]
        lines.append([row.codec, row.frames, f"{100 * row.size:.1f} %", *times])
    head = ["codec", "frames", "size", "encode, ms on one core", "decode", "decode, ms on all cores"]
    text = """## Lossless codecs

Of a frame; what comes back is compared. Differences of frames are taken modulo 256.

"""
    return text + table(head, lines) + "\n"


def _rest(figures: list[Figure]) -> str:
    lines = [[figure.key, f"{figure.value:.4g}", "" if figure.unit == "1" else figure.unit] for figure in figures]
    return "## All figures\n\n" + table(["figure", "value", "unit"], lines) + "\n"


OWN, OTHER, BOUND = "#1f6f8b", "#b8b8b8", "#e0a458"


def draw(path: Path, contestants: list[tuple[str, float]]) -> None:
    """Bars of ms/pair on a logarithmic axis, the slowest on top."""
    ordered = sorted(contestants, key=lambda bar: -bar[1])
    bars = [(name, time, _colour(name)) for name, time in ordered]
    figure = Picture(figsize=(8.0, 0.36 * len(bars) + 1.3), layout="constrained")
    axes = figure.subplots()
    place = range(len(bars))
    axes.barh(place, [time for _, time, _ in bars], color=[colour for *_, colour in bars])
    for at, (_, taken, _) in zip(place, bars, strict=True):
        axes.annotate(f"{taken:.3g}", (taken, at), (4, 0), textcoords="offset points", va="center", fontsize=9)
    axes.set_yticks(list(place), [name for name, *_ in bars])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlim(0.4 * min(time for _, time, _ in bars), 2.0 * max(time for _, time, _ in bars))
    axes.xaxis.set_major_formatter(lambda time, _: f"{time:g}")
    axes.set_xlabel("ms per pair of 1280 x 1024, two cores")
    axes.set_title("Frames in memory to coloured points (grey: others, amber: bounds)", fontsize=10, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def _colour(name: str) -> str:
    if name.startswith("ours"):
        return OWN
    return BOUND if name in ("fused", "read") else OTHER


SECTIONS = ("memory", "png", "packed", "shards", "codecs", "calibration", "cold")
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
    parser = command_line(__doc__, quick="few pairs: to see that it runs", json=True)
    parser.add_argument("--only", choices=SECTIONS, help="one section")
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="where captures go for a while: up to 10 GB")
    parser.add_argument("--results", type=Path, metavar="DIR", help="write tables and plot there")
    options = parser.parse_args()
    size = QUICK if options.quick else FULL
    sections = [options.only] if options.only else list(SECTIONS)
    about, scanner = machine(), make_scanner()
    rows, codecs, figures = [], [], []
    if "memory" in sections:
        frames = make_frames(size.pairs, scanner)
        rows = measure_memory(frames, size.repeats)
        figures += memory_figures(rows) + small_figures(frames, size.repeats)
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
        write_results(results, about, Found(rows, codecs, figures), size.pairs)
    document = {"format": "jaxscan-experiment-speed/1", "quick": options.quick, **about}
    write_json(options.json, document | {"metrics": [figure._asdict() for figure in figures]})


if __name__ == "__main__":
    main()
