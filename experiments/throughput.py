"""Speed of a whole reconstruction against the usual NumPy and OpenCV pipeline, in one run.

All get the same stack of frames in memory and end with coloured points in the room. Ours also
gives sub-pixel centres by a weighted fit with their noise, normals and two sigmas per point; the
usual pipeline, and a lean one that does without its box filter, give centroids and nothing beside.
"ours_same" leaves the normals out, which the others do not have either.
"stripes" and "points" time ours in two halves: frames to centres (in one thread), and the rest.

    python experiments/throughput.py [--quick] [--json FILE]
"""

import argparse
import itertools
import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import jax
import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import NoiseModel, extract_stripes


WIDTH, HEIGHT = 1280, 1024
THREADS = 2
DISTORTION = np.array([-0.21, 0.09, 4e-4, -3e-4, 0.0])


def make_scanner() -> Scanner:
    """About the paper's rig at 1280 x 1024."""
    camera = Pinhole(*(np.float64(x) for x in (1809.0, 1804.6, 635.3, 510.6)), DISTORTION, width=WIDTH, height=HEIGHT)
    sheet = LaserSheet.from_abc(-7.606, -1.685, 1.296203)
    return Scanner(camera, stack_lasers([sheet]), Turntable.from_axis([-0.018, -1.0, -0.001], [-0.01, 0.0, -0.212]))


def make_frames(pairs: int) -> tuple[np.ndarray, np.ndarray]:
    """Noisy pairs of a stripe on a wall, uint8 [pairs, rows, columns]: eight, shifted."""
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    on, off = (np.empty((pairs, HEIGHT, WIDTH), np.uint8) for _ in range(2))
    room = 40.0 + 20.0 * np.sin(columns / 90.0) * np.cos(rows / 70.0)
    for base in range(min(8, pairs)):
        centre = 700.0 + 40.0 * np.sin(rows[:, :1] / 200.0 + base) - 60.0 * rows[:, :1] / HEIGHT
        stripe = 110.0 * np.exp(-0.5 * ((columns - centre) / 1.9) ** 2)
        for stack, light in ((on, room + stripe), (off, room)):
            noise = np.sqrt(1.0 + light / 40.0) * rng.standard_normal(light.shape, np.float32)
            stack[base] = np.clip(np.round(light + noise), 0, 255)
    for number in range(8, pairs):
        shift = 13 * (number // 8)
        for stack in (on, off):
            stack[number] = np.roll(stack[number % 8], shift, axis=0)
    return on, off


Centres = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A frame's laser-on and laser-off image to the stripe's centre on every row, and where it is."""

ROWS = np.arange(HEIGHT)[:, None]


def usual_centres(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As the well-known desk scanners do it, with their defaults, but for all rows at once.

    Source: bqlabs/horus, `laser_segmentation.py` (subtract, threshold, 5 x 5 box, threshold,
    highest pixel, centroid within 8 px); its forks do the same.
    """
    difference = cv2.subtract(on, off)
    cv2.threshold(difference, 50, 255, cv2.THRESH_TOZERO, dst=difference)
    cv2.blur(difference, (5, 5), dst=difference)
    cv2.threshold(difference, 50, 255, cv2.THRESH_TOZERO, dst=difference)
    return _centroid(difference, difference.argmax(axis=1), 8, 0)


def lean_centres(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least that gives a centroid: one blurred row at a time, one threshold."""
    difference = cv2.subtract(on, off)
    blurred = cv2.GaussianBlur(difference, (5, 1), 0)
    peak = blurred.argmax(axis=1)
    u, _ = _centroid(difference, peak, 6, 6)
    return u, blurred[ROWS[:, 0], peak] > 12


def _centroid(image: np.ndarray, peak: np.ndarray, reach: int, least: int) -> tuple[np.ndarray, np.ndarray]:
    columns = np.clip(peak[:, None] + np.arange(-reach, reach + 1), 0, WIDTH - 1)
    window = image[ROWS, columns].astype(np.float32)
    window[window < least] = 0
    total = window.sum(1)
    return (window * columns).sum(1) / np.maximum(total, 1.0), total > 0


def pipeline(centres: Centres, scanner: Scanner, on: np.ndarray, off: np.ndarray, angle: np.ndarray) -> Callable:
    """From centres to coloured points: frames over threads, everything prepared that can be."""
    camera = scanner.camera
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], float)
    normal = np.asarray(scanner.lasers.normal[0], np.float32)
    distance = float(scanner.lasers.distance[0])
    with jax.enable_x64(True):
        poses = np.asarray(jax.jit(jax.vmap(scanner.as_dtype(np.float64).pose))(angle)).astype(np.float32)
    xyz = np.zeros((len(on), HEIGHT, 3), np.float32)
    rgb = np.zeros((len(on), HEIGHT, 3), np.uint8)

    def one(number: int) -> int:
        u, valid = centres(on[number], off[number])
        found = np.flatnonzero(valid)
        q = np.stack([u[valid], found.astype(np.float32)], -1)[:, None, :].astype(np.float32)
        x = cv2.undistortPoints(q, matrix, DISTORTION)[:, 0]
        ray = np.column_stack([x, np.ones(len(x), np.float32)])
        p = ray * (distance / (ray @ normal))[:, None]
        xyz[number, found] = p @ poses[number, :3, :3].T + poses[number, :3, 3]
        left = np.clip(q[:, 0, 0].astype(int), 0, WIDTH - 2)
        weight = q[:, 0, 0] - left
        grey = (1 - weight) * off[number][found, left] + weight * off[number][found, left + 1]
        rgb[number, found] = np.round(grey)[:, None].astype(np.uint8)
        return len(found)

    def run() -> int:
        with ThreadPoolExecutor(THREADS) as pool:
            return sum(pool.map(one, range(len(on))))

    return run


def read_everything(on: np.ndarray, off: np.ndarray) -> None:
    """Add up all bytes, eight at a time, on all threads: what merely touching the frames costs."""
    parts = [part.reshape(-1).view(np.uint64) for stack in (on, off) for part in np.array_split(stack, THREADS)]
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(np.sum, parts))


class Time(NamedTuple):
    """What a run takes [s]: the fastest of some."""

    wall: float
    processor: float
    """Of all cores together; unlike the wall's it hardly depends on what else the machine does."""


def best_of(functions: dict[str, Callable[[], object]], repeats: int) -> dict[str, Time]:
    """Times of all functions, taken in turn, after one run each to warm up."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in functions}
    for repeat in range(repeats + 1):
        for name, function in functions.items():
            start, used = time.perf_counter(), time.process_time()
            function()
            if repeat > 0:
                times[name].append((time.perf_counter() - start, time.process_time() - used))
    return {name: Time(min(wall for wall, _ in runs), min(cpu for _, cpu in runs)) for name, runs in times.items()}


def measure(pairs: int, repeats: int) -> list[dict]:
    """All figures as key, value, unit, direction, relative tolerance."""
    scanner = make_scanner()
    on, off = make_frames(pairs)
    angle = np.radians(0.1) * np.arange(pairs)
    sweep, noise = Sweep(on, off, angle), NoiseModel()
    stripes = extract_stripes(on, off, noise=noise)
    peers = {"usual": usual_centres, "lean": lean_centres}
    runs = {name: pipeline(centres, scanner, on, off, angle) for name, centres in peers.items()}
    # OpenCV's own threads would only compete with the threads over frames.
    cv2.setNumThreads(1)
    times = best_of(
        {
            "read": lambda: read_everything(on, off),
            "ours": lambda: reconstruct(sweep, scanner, noise=noise),
            "ours_same": lambda: reconstruct(sweep, scanner, noise=noise, settings=ReconstructSettings(normals=False)),
            "stripes": lambda: np.asarray(extract_stripes(on, off, noise=noise).u),
            "points": lambda: reconstruct(sweep, scanner, stripes=stripes, noise=noise),
            **runs,
        },
        repeats,
    )
    cloud = reconstruct(sweep, scanner, noise=noise)
    rows = []
    for name in ("ours", "ours_same", "usual", "lean", "read", "stripes", "points"):
        rows.append((f"{name}_wall", 1e3 * times[name].wall / pairs, "ms/pair", "lower", 0.3))
        rows.append((f"{name}_cpu", 1e3 * times[name].processor / pairs, "ms/pair", "lower", 0.2))
    for name, own in itertools.product(peers, ("ours", "ours_same")):
        rows.append((f"{name}_over_{own}", times[name].wall / times[own].wall, "1", "higher", 0.3))
        rows.append((f"{name}_over_{own}_cpu", times[name].processor / times[own].processor, "1", "higher", 0.2))
    rows.append(("bandwidth", (on.nbytes + off.nbytes) / times["read"].wall / 1e9, "GB/s", "higher", 0.5))
    rows.append(("ours_points", float(cloud.valid.mean()), "of lines", "higher", 0.02))
    for name, run in runs.items():
        rows.append((f"{name}_points", run() / cloud.valid.size, "of lines", "higher", 0.02))
    rows.append(("load", os.getloadavg()[0], "1", "none", 1.0))
    return [
        {"key": key, "value": value, "unit": unit, "direction": direction, "tolerance": tolerance}
        for key, value, unit, direction, tolerance in rows
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="48 pairs, one repeat: to see that it runs")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file (- for standard output)")
    arguments = parser.parse_args()
    pairs, repeats = (48, 1) if arguments.quick else (256, 4)
    metrics = measure(pairs, repeats)
    for row in metrics:
        print(f"{row['key']:>20} {row['value']:10.3f} {row['unit']}", file=sys.stderr)
    if arguments.json:
        text = json.dumps(
            {"format": "jaxscan-throughput/1", "pairs": pairs, "quick": arguments.quick, "metrics": metrics}
        )
        if arguments.json == "-":
            print(text)
        else:
            with open(arguments.json, "w") as file:
                file.write(text + "\n")


if __name__ == "__main__":
    main()
