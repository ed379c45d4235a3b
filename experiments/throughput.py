"""Speed of a whole reconstruction against the usual NumPy and OpenCV pipeline, in one run.

Both get the same stack of frames in memory and end with coloured points in the room. Ours also
gives sub-pixel centres by a weighted fit with their noise, normals and two sigmas per point; the
usual pipeline gives centroids and nothing beside.

    python experiments/throughput.py [--quick] [--json FILE]
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import cv2
import jax
import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.reconstruction import Sweep, reconstruct
from jaxscan.stripes.stripes import NoiseModel


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


def usual_pipeline(scanner: Scanner, on: np.ndarray, off: np.ndarray, angle: np.ndarray) -> Callable[[], int]:
    """The usual pipeline, frames over threads, everything that can be prepared prepared."""
    camera = scanner.camera
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], float)
    normal = np.asarray(scanner.lasers.normal[0], np.float32)
    distance = float(scanner.lasers.distance[0])
    with jax.enable_x64(True):
        poses = np.asarray(jax.jit(jax.vmap(scanner.as_dtype(np.float64).pose))(angle)).astype(np.float32)
    rows = np.arange(HEIGHT)
    offsets = np.arange(-6, 7)
    xyz = np.zeros((len(on), HEIGHT, 3), np.float32)
    rgb = np.zeros((len(on), HEIGHT, 3), np.uint8)

    def one(number: int) -> int:
        difference = cv2.subtract(on[number], off[number])
        blurred = cv2.GaussianBlur(difference, (5, 1), 0)
        peak = blurred.argmax(axis=1)
        valid = blurred[rows, peak] > 12
        columns = np.clip(peak[:, None] + offsets, 0, WIDTH - 1)
        window = difference[rows[:, None], columns].astype(np.float32)
        window[window < 6] = 0
        u = (window * columns).sum(1) / np.maximum(window.sum(1), 1.0)
        found = rows[valid]
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


def best_of(function: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest of some runs, after one to warm up."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def measure(pairs: int, repeats: int) -> list[dict]:
    """All figures as key, value, unit, direction, relative tolerance."""
    scanner = make_scanner()
    on, off = make_frames(pairs)
    angle = np.radians(0.1) * np.arange(pairs)
    sweep, noise = Sweep(on, off, angle), NoiseModel()
    read = best_of(lambda: read_everything(on, off), repeats)
    ours = best_of(lambda: reconstruct(sweep, scanner, noise=noise), repeats)
    usual, threads = min(
        (best_of(run_with(threads, usual_pipeline(scanner, on, off, angle)), repeats), threads)
        for threads in (1, THREADS)
    )
    cloud = reconstruct(sweep, scanner, noise=noise)
    found = usual_pipeline(scanner, on, off, angle)()
    rows = [
        ("ours", 1e3 * ours / pairs, "ms/pair", "lower", 0.3),
        ("usual", 1e3 * usual / pairs, "ms/pair", "lower", 0.3),
        ("speedup", usual / ours, "1", "higher", 0.3),
        ("plain_read", 1e3 * read / pairs, "ms/pair", "lower", 0.5),
        ("bandwidth", (on.nbytes + off.nbytes) / read / 1e9, "GB/s", "higher", 0.5),
        ("ours_points", float(cloud.valid.mean()), "of lines", "higher", 0.02),
        ("usual_points", found / cloud.valid.size, "of lines", "higher", 0.02),
        ("opencv_threads", threads, "1", "none", 1.0),
    ]
    return [
        {"key": key, "value": value, "unit": unit, "direction": direction, "tolerance": tolerance}
        for key, value, unit, direction, tolerance in rows
    ]


def run_with(threads: int, run: Callable[[], int]) -> Callable[[], int]:
    """The pipeline with OpenCV's own threads set."""

    def configured() -> int:
        cv2.setNumThreads(threads)
        return run()

    return configured


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="48 pairs, one repeat: to see that it runs")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file (- for standard output)")
    arguments = parser.parse_args()
    pairs, repeats = (48, 1) if arguments.quick else (256, 4)
    metrics = measure(pairs, repeats)
    for row in metrics:
        print(f"{row['key']:>16} {row['value']:10.3f} {row['unit']}", file=sys.stderr)
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
