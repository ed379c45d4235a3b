"""Speed and memory of a reconstruction beside a plain pipeline, of calibrations, and of the first result.

    python -m experiments.speed [--only SECTION …] [--quick] [--scratch DIR] [--json FILE] [--results DIR]

- memory: pairs in memory to coloured points. Ours fits sub-pixel centres with their noise, chooses among several
  reflections, and gives normals and two sigmas a point; `lean` is the least that gives a centroid, `read` one pass
  over the bytes. All get the same stacks, in turn.
- packed: a sweep from files, in a process of its own: time by the number of records, memory without the pages of files
  and how it grows with the sweep, and a cloud again from cached stripes.
- calibration: warm solves, and the camera alone beside OpenCV's.
- cold: the demo and a calibration of its boards as commands, with nothing compiled, and again.

Compilation is not timed, but in `cold`. Limits are for a quiet machine with two cores; where others use it, processor
time tells more than wall time. Without --quick and --only the page experiments/results/speed.md is written anew.
"""

import argparse
import ctypes
import dataclasses
import gc
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import jax
import numpy as np

from experiments import exact_rig
from experiments.exact_rig import PosePlan, add_noise, draw_poses, ideal_boards
from experiments.report import RESULTS, Figure, command_line, conclude, figure_table, machine, progress, table, verb
from experiments.speed_scene import DISTINCT, DISTORTION, HEIGHT, WIDTH, Frames, make_angles, make_frames, make_scanner
from jaxscan.calibration import CalibrationSettings, calibrate_camera, calibrate_observations
from jaxscan.files.capture import cache_path, cached_stripes, frames_key, open_capture, save_stripes
from jaxscan.geometry import Scanner
from jaxscan.observation import Observations
from jaxscan.reconstruction import PointCloud, ReconstructSettings, Sweep, extract, reconstruct
from jaxscan.stripes import Stripes, StripeSettings, extract_stripes
from jaxscan.vision import encode_zstd


THREADS = 2
"""As many as there are cores: frames over threads, since NumPy and OpenCV let go of the lock."""


class Times(NamedTuple):
    """Times of several runs of one function [s]."""

    best: float
    processor: float
    """Least time of all cores together; unlike wall time, it hardly depends on the load of the machine."""


def take_turns(functions: dict[str, Callable[[], object]], repeats: int) -> dict[str, Times]:
    """Times of all functions, taken in turn, after one run each to compile and to touch the memory."""
    runs: dict[str, list[tuple[float, float]]] = {name: [] for name in functions}
    for repeat in range(repeats + 1):
        for name, function in functions.items():
            start, used = time.perf_counter(), time.process_time()
            function()
            if repeat > 0:
                runs[name].append((time.perf_counter() - start, time.process_time() - used))
    return {name: Times(*map(min, zip(*found, strict=True))) for name, found in runs.items()}


class Size(NamedTuple):
    """How much is measured."""

    pairs: int
    """In memory; far more than any cache holds."""
    repeats: int
    packed: tuple[int, ...]


FULL, QUICK = Size(512, 5, (400, 1200, 3600)), Size(48, 1, (50, 100))


def memory(size: Size, scratch: Path) -> tuple[list[Figure], str]:
    """Whole pipelines on all frames."""
    frames, scanner = make_frames(size.pairs, make_scanner()), make_scanner()
    angle = make_angles(size.pairs)
    sweep = Sweep(frames.on, frames.off, angle)
    plain = ReconstructSettings(stripes=StripeSettings(estimator="centre_of_gravity"))
    words = [stack.reshape(-1).view(np.uint64) for stack in (frames.on, frames.off)]
    parts = [part for whole in words for part in np.array_split(whole, 8 * THREADS)]
    # OpenCV's own threads would only compete with the threads over frames.
    cv2.setNumThreads(1)
    points: dict[str, float] = {}
    u = np.full((size.pairs, HEIGHT), np.nan, np.float32)
    with ThreadPoolExecutor(THREADS) as pool:

        def ours(name: str, settings: ReconstructSettings) -> Callable[[], None]:
            def run() -> None:
                points[name] = float(reconstruct(sweep, scanner, settings=settings).valid.mean())

            return run

        runs = {
            "ours": ours("ours", ReconstructSettings()),
            "ours, no normals": ours("ours, no normals", ReconstructSettings(normals=False)),
            "ours, centre of gravity": ours("ours, centre of gravity", plain),
            "lean": pipeline(scanner, frames, angle, u, pool),
            "read": lambda: list(pool.map(np.sum, parts)),
        }
        times = take_turns(runs, size.repeats)
    cv2.setNumThreads(-1)
    found = extract_stripes(frames.on[:DISTINCT], frames.off[:DISTINCT])
    right = {"lean": _right(u, frames), "ours": _right(np.where(found.valid, found.u, np.nan), frames)}
    points["lean"] = float(np.isfinite(u).mean())
    figures = [
        Figure("ours over lean, processor", times["ours"].processor / times["lean"].processor, "1"),
        Figure("ours over read, wall", times["ours"].best / times["read"].best, "1"),
    ]
    rows = []
    for name, one in times.items():
        each = [f"{1e3 * seconds / size.pairs:.3f}" for seconds in one]
        shares = ["" if name not in of else f"{100 * of[name]:.1f} %" for of in (points, right)]
        rows.append([name, *each, *shares])
    head = ["", "best, ms/pair", "processor, ms/pair", "lines with a point", "stripes within 1 px"]
    return figures, table(head, rows)


def lean_centres(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A frame's stripe on every row, and where it is: one blurred row at a time, one threshold, a centroid of 13 px."""
    difference = cv2.subtract(on, off)
    blurred = cv2.GaussianBlur(difference, (5, 1), 0)
    peak = blurred.argmax(axis=1)
    columns = peak[:, None] + np.arange(-6, 7)
    inside = (columns >= 0) & (columns < WIDTH)
    window = difference[np.arange(HEIGHT)[:, None], np.clip(columns, 0, WIDTH - 1)].astype(np.float32)
    window[(window < 6) | ~inside] = 0
    u = (window * columns).sum(1) / np.maximum(window.sum(1), 1.0)
    return u, blurred[np.arange(HEIGHT), peak] > 12


def pipeline(
    scanner: Scanner, frames: Frames, angle: np.ndarray, every_u: np.ndarray, pool: ThreadPoolExecutor
) -> Callable[[], object]:
    """From `lean_centres` to coloured points in single precision, with distortion; all prepared that can be.

    Args:
        every_u: Takes the centres of a run [pairs, rows], px; NaN where there is none.
    """
    camera = scanner.camera
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], float)
    normal, distance = np.asarray(scanner.lasers.normal[0], np.float32), float(scanner.lasers.distance[0])
    with jax.enable_x64(True):
        poses = np.asarray(jax.jit(jax.vmap(scanner.as_dtype(np.float64).pose))(angle)).astype(np.float32)
    shape = (len(angle), HEIGHT, 3)
    xyz, rgb = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)

    def one(number: int) -> None:
        off = frames.off[number]
        u, valid = lean_centres(frames.on[number], off)
        found = np.flatnonzero(valid)
        q = np.stack([u[valid], found.astype(np.float32)], -1)[:, None, :].astype(np.float32)
        x = cv2.undistortPoints(q, matrix, DISTORTION)[:, 0]
        ray = np.column_stack([x, np.ones(len(x), np.float32)])
        p = ray * (distance / (ray @ normal))[:, None]
        xyz[number, found] = p @ poses[number, :3, :3].T + poses[number, :3, 3]
        left = np.clip(q[:, 0, 0].astype(int), 0, WIDTH - 2)
        weight = q[:, 0, 0] - left
        grey = (1 - weight) * off[found, left] + weight * off[found, left + 1]
        rgb[number, found] = np.round(grey)[:, None].astype(np.uint8)
        every_u[number] = np.where(valid, u, np.nan)

    return lambda: list(pool.map(one, range(len(angle))))


def _right(u: np.ndarray, frames: Frames) -> float:
    """Share of the stripes drawn whose centre was found within 1 px, among the distinct pairs."""
    first = slice(0, min(DISTINCT, len(u)))
    close = np.abs(np.nan_to_num(u[first], nan=-1e6) - frames.u[first]) < 1.0
    return float(close[frames.lit[first]].mean())


HEADER = f"""format = "jaxscan-capture/1"
kind = "sweep"
[camera]
width = {WIDTH}
height = {HEIGHT}
pixel_format = "mono8"
[laser]
name = "laser"
"""
CHUNK = 16
"""Records at a time where memory is compared: so few that the shortest sweep has as many chunks in flight as any."""
GROWTH_BYTES = 60.0
"""Most that a cell of the cloud's grid may take: 40 for the cloud's fields, the rest for its records."""
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_ARENA_MAX": "2"}
"""Arrays are mapped one by one and unmapped when they are free, so that resident memory is used memory."""


def write_capture(folder: Path, records: int) -> None:
    """A capture with the scene's frames, over and over, as captures are stored; every record has files of its own."""
    folder.mkdir()
    frames = make_frames(DISTINCT, make_scanner())
    for kind, stack in (("on", frames.on), ("off", frames.off)):
        data = [encode_zstd(frame) for frame in stack]
        for number in range(records):
            (folder / f"{kind}{number}.zst").write_bytes(data[number % DISTINCT])
    (folder / "capture.toml").write_text(HEADER)
    with open(folder / "frames.jsonl", "w") as journal:
        for i in range(records):
            images = {kind: f"{kind}{i}.zst" for kind in ("on", "off")}
            journal.write(json.dumps({"i": i, "angle_deg": 360.0 * i / records, **images}) + "\n")


def packed(size: Size, scratch: Path) -> tuple[list[Figure], str]:
    """A long sweep as captures are stored: time and memory by its length, and again from cached stripes."""
    counts, most = size.packed, size.packed[-1]
    write_capture(scratch / "packed", most)
    words = [sys.executable, "-m", "experiments.speed", "--inside", str(scratch / "packed")]
    words += ["--quick"] if size == QUICK else []
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True, env={**os.environ, **ALLOCATOR})
    found = json.loads(done.stdout)
    full = most == FULL.packed[-1]
    figures = [
        Figure(f"{most} pairs, best", found["walls"][-1], "s", high=6.0 if full else None),
        Figure("peak memory without file pages", found["peak_bytes"] / 1e9, "GB", high=1.5),
        Figure("memory by the length of the sweep", found["growth_bytes"], "B/cell", high=GROWTH_BYTES),
        Figure(f"again from cached stripes, {most} pairs", found["again_s"], "s", high=3.0 if full else None),
    ]
    rows = [
        [f"{count}", f"{1e3 * wall / count:.3f}", f"{1e3 * used / count:.3f}", f"{need / 1e6:.0f}"]
        for count, wall, used, need in zip(counts, found["walls"], found["used"], found["needed_bytes"], strict=True)
    ]
    return figures, table(["pairs", "best, ms/pair", "processor, ms/pair", "memory of small chunks, MB"], rows)


def packed_inside(folder: Path, size: Size) -> dict[str, Any]:
    """Seconds and memory at each length, the peak, the growth for each cell, and seconds from cached stripes."""
    capture, scanner = open_capture(folder), make_scanner()
    small = ReconstructSettings(chunk_records=CHUNK)
    part = lambda count: dataclasses.replace(capture, records=capture.records[:count])
    functions = {str(count): lambda count=count: reconstruct(part(count), scanner) for count in size.packed}
    with Watch() as watch:
        times = take_turns(functions, min(size.repeats, 2))
    needed, cells = [], []
    for count in size.packed:
        # The compiler's memory varies by more than a cloud: the first of two passes is for it.
        for _ in range(2):
            cloud: PointCloud | None = None
            gc.collect()
            ctypes.CDLL(None).malloc_trim(0)
            before = anonymous_bytes()
            with Watch() as own:
                cloud = reconstruct(part(count), scanner, settings=small)
        assert cloud is not None
        needed.append(own.peak - before)
        cells.append(cloud.valid.size)
    stripes = extract(capture, scanner).stripes
    fields = {field.name: np.asarray(getattr(stripes, field.name)) for field in dataclasses.fields(stripes)}
    save_stripes(cache_path(capture), fields, {"frames": frames_key(capture)})

    def from_cache() -> PointCloud:
        kept = cached_stripes(cache_path(capture), {"frames": frames_key(capture)})
        assert kept is not None
        return reconstruct(capture, scanner, stripes=Stripes(**kept))

    again = take_turns({"again": from_cache}, 2)["again"]
    return {
        "walls": [times[str(count)].best for count in size.packed],
        "used": [times[str(count)].processor for count in size.packed],
        "peak_bytes": watch.peak,
        "needed_bytes": needed,
        "growth_bytes": (needed[-1] - needed[0]) / (cells[-1] - cells[0]),
        "again_s": again.best,
    }


class Watch:
    """Largest anonymous memory of this process while open; pages of mapped files do not count."""

    def __init__(self) -> None:
        self.peak = anonymous_bytes()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *problem: object) -> None:
        self._done.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._done.wait(0.005):
            self.peak = max(self.peak, anonymous_bytes())


def anonymous_bytes() -> int:
    """Resident memory of this process that belongs to no file [bytes]."""
    with open("/proc/self/status") as status:
        fields = dict(line.split(":", 1) for line in status)
    return 1024 * sum(int(fields[name].split()[0]) for name in ("RssAnon", "RssShmem"))


VIEWS, FEWER_VIEWS, CAMERA_VIEWS = 40, 37, 23
COMPILING = "/jax/core/compile/backend_compile_duration"


def calibration(size: Size, scratch: Path) -> tuple[list[Figure], str]:
    """Warm times, the camera alone beside OpenCV's, and how much another number of views compiles."""
    rig, plain = _boards(PosePlan(free_views=VIEWS - 9, placements=3, angles=3)), CalibrationSettings(judge=False)
    compiled: list[float] = []

    def listen(event: str, duration: float, **_: object) -> None:
        if event == COMPILING:
            compiled.append(duration)

    calibrate_observations(rig)
    jax.monitoring.register_event_duration_secs_listener(listen)
    calibrate_observations(_boards(PosePlan(free_views=FEWER_VIEWS - 9, placements=3, angles=3)))
    others = len(compiled)
    corners = _boards(PosePlan(free_views=CAMERA_VIEWS, lit=0))
    points = [corners.board.corners().astype(np.float32)] * CAMERA_VIEWS
    pixels = [q.astype(np.float32) for q in corners.corners.q]
    image = (corners.width, corners.height)
    times = take_turns(
        {
            f"rig, {VIEWS} views": lambda: calibrate_observations(rig, settings=plain),
            f"rig, {VIEWS} views, models judged": lambda: calibrate_observations(rig),
            f"camera alone, {CAMERA_VIEWS} views": lambda: calibrate_camera(corners, settings=plain),
            f"camera alone, {CAMERA_VIEWS} views, OpenCV": lambda: cv2.calibrateCamera(
                points, pixels, image, None, None
            ),
        },
        size.repeats,
    )
    solve, _, ours, theirs = times.values()
    figures = [
        Figure(f"rig, {VIEWS} views, best", solve.best, "s", high=0.4),
        Figure("camera alone over OpenCV", ours.best / theirs.best, "1", high=1.0),
        Figure(f"functions compiled for {FEWER_VIEWS} views after {VIEWS}", others, "", high=0.0),
    ]
    return figures, table(
        ["warm", "best, s", "processor, s"], [[name, *map("{:.3f}".format, one)] for name, one in times.items()]
    )


def _boards(plan: PosePlan) -> Observations:
    """Views of the reference rig, with the noise of a detector."""
    config = exact_rig.reference()
    noisy = add_noise(ideal_boards(config, draw_poses(config, 3, plan), points=1000), np.random.default_rng(0))
    return exact_rig.observations(noisy, config)


def cold(size: Size, scratch: Path) -> tuple[list[Figure], str]:
    """The demo and a calibration of its boards, cold and again."""
    figures, rows = [], []
    boards = ("calibrate", scratch / "cold" / "captures" / "boards", "-o")
    for run, limits in (("cold", (60.0, 20.0)), ("again", (35.0, 8.0))):
        commands = {"demo": ("demo", "-o", scratch / run), "boards": (*boards, scratch / f"{run}.json")}
        for (name, words), limit in zip(commands.items(), limits, strict=True):
            done = verb(*words, XDG_CACHE_HOME=str(scratch / f"cache of {name}"))
            if done.code:
                raise SystemExit(f"jaxscan {name}: exit code {done.code}: {done.problem[-2000:]}")
            figures.append(Figure(f"{name}, {run}", done.wall_s, "s", high=limit))
            rows.append([f"{name}, {run}", f"{done.wall_s:.1f}", f"{done.processor_s:.1f}"])
    return figures, table(["command", "wall, s", "processor, s"], rows)


SECTIONS: dict[str, Callable[[Size, Path], tuple[list[Figure], str]]] = {
    "memory": memory,
    "packed": packed,
    "calibration": calibration,
    "cold": cold,
}


def main() -> int:
    """The command."""
    parser = command_line(__doc__, quick="few pairs: to see that it runs", json=True)
    parser.add_argument("--only", nargs="*", choices=SECTIONS, default=list(SECTIONS), help="some sections")
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="where captures go for a while: up to 6 GB")
    parser.add_argument("--results", type=Path, metavar="DIR", help="write the page there")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    size = QUICK if options.quick else FULL
    if options.inside:
        print(json.dumps(packed_inside(options.inside, size)))
        return 0
    figures: list[Figure] = []
    head = f"Written by `python -m experiments.speed`; {machine()}; load average {os.getloadavg()[0]:.1f} at the start."
    head += " **Bold**: misses its limit, which is for a quiet machine."
    head += f" Sizes of --quick: {size.pairs} pairs in memory, {size.packed[-1]} packed." if options.quick else ""
    page = ["# Speed of a reconstruction", head]
    for section in options.only:
        start, load = time.perf_counter(), os.getloadavg()[0]
        scratch = Path(tempfile.mkdtemp(prefix="jaxscan-speed-", dir=options.scratch))
        try:
            own, text = SECTIONS[section](size, scratch)
        finally:
            shutil.rmtree(scratch)
        progress(f"{section}: {time.perf_counter() - start:.0f} s, load average {load:.1f}\n{text}")
        figures += [figure._replace(key=f"{section}: {figure.key}") for figure in own]
        page += [f"## {section}", text, figure_table(own)]
    results = options.results or (RESULTS if len(options.only) == len(SECTIONS) and not options.quick else None)
    if results is not None:
        (results / "speed.md").write_text("\n\n".join(page) + "\n")
    return conclude("speed", figures, options.json, quick=options.quick)


if __name__ == "__main__":
    sys.exit(main())
