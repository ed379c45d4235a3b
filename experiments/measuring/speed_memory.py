"""Whole pipelines on stacks in memory, for `speed.py`: ours, others in NumPy and OpenCV, and bounds, in turn.

All pipelines end in coloured points: `horus` as the well-known desk scanner does it, operation by operation; `usual`
the same for all rows at once; `lean` the least that gives a centroid. `fused` and `read` are bounds: peak and
centroid alone, in 8 bit, and one pass over the bytes.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import cv2
import jax
import numpy as np
from measuring.speed_times import Contestant, Figure, Times, take_turns
from paper.methods import HORUS_REACH, centroid, horus_centres
from worlds.speed_scene import (
    DISTINCT,
    DISTORTION,
    ELECTRONS_PER_DN,
    HEIGHT,
    READ_DN,
    WIDTH,
    Frames,
    make_angles,
    make_scanner,
)

from jaxscan.geometry import Scanner
from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import NoiseModel, StripeSettings, extract_stripes


THREADS = 2
"""As many as there are cores: frames over threads, since NumPy and OpenCV let go of the lock."""
REACH = HORUS_REACH
_ROWS = np.arange(HEIGHT)[:, None]

Centres = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A frame's laser-on and laser-off image to the stripe's centre on every row, and where it is."""


class Peer(NamedTuple):
    """A pipeline ready to run on a stack, and where its points go."""

    run: Callable[[], int]
    """Returns the number of points."""
    u: np.ndarray
    """Centres of the last run [pairs, rows], px; NaN where there is none."""


def horus(scanner: Scanner, on: np.ndarray, off: np.ndarray, angle: np.ndarray, pool: ThreadPoolExecutor) -> Peer:
    """Operation by operation as the desk scanner's laser segmentation and point cloud generation.

    8-bit difference, threshold 50, 5 x 5 box, threshold again, a mask of 8 px around each row's
    maximum drawn row by row in Python, the centroid as a sum over the whole frame of pixels times
    a matrix of column numbers; then, in double precision, pixels to rays without distortion, the
    plane, the rig's pose at angle 0, the turn about the axis, the nearest pixel's colour. Its
    smoothing along the stripe is left out: it is an option, and no other pipeline here has it.

    Source: bqlabs/horus, `laser_segmentation.py` and `point_cloud_generation.py`, described anew.
    """
    camera = scanner.camera
    column = np.repeat(np.arange(WIDTH, dtype=float)[None, :], HEIGHT, 0)
    normal, distance = np.asarray(scanner.lasers.normal[0], float), float(scanner.lasers.distance[0])
    start = _poses(scanner, np.zeros(1))[0].astype(float)
    xyz, rgb, u = _results(len(on))

    def one(number: int) -> int:
        difference = cv2.subtract(on[number], off[number])
        image = cv2.threshold(difference, 50, 255, cv2.THRESH_TOZERO)[1]
        image = cv2.threshold(cv2.blur(image, (5, 5)), 50, 255, cv2.THRESH_TOZERO)[1]
        peak = image.argmax(axis=1)
        first, last = np.maximum(peak - REACH, 0), np.minimum(peak + REACH + 1, WIDTH)
        mask = np.zeros_like(image)
        for row in range(HEIGHT):
            mask[row, first[row] : last[row]] = 255
        image = cv2.bitwise_and(image, mask)
        total = image.sum(axis=1)
        v = np.where(total > 0)[0]
        centre = (column * image).sum(axis=1)[v] / total[v]

        rays = np.stack([(centre - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(v))])
        p = distance / (normal @ rays) * rays
        p = start[:3, :3] @ p + start[:3, 3:]
        sine, cosine = np.sin(angle[number]), np.cos(angle[number])
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        u[number] = np.nan
        u[number, v] = centre
        xyz[number, v] = (turn @ p).T
        rgb[number, v] = off[number][v, np.around(centre).astype(int)][:, None]
        return len(v)

    return Peer(lambda: sum(pool.map(one, range(len(on)))), u)


def usual_centres(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same centroids as `horus`, for all rows at once and in the window alone."""
    return horus_centres(on, off)


def lean_centres(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least that gives a centroid: one blurred row at a time, one threshold."""
    difference = cv2.subtract(on, off)
    blurred = cv2.GaussianBlur(difference, (5, 1), 0)
    peak = blurred.argmax(axis=1)
    u, _ = centroid(difference, peak, 6, 6)
    return u, blurred[_ROWS[:, 0], peak] > 12


def pipeline(
    centres: Centres, scanner: Scanner, on: np.ndarray, off: np.ndarray, angle: np.ndarray, pool: ThreadPoolExecutor
) -> Peer:
    """From centres to coloured points in single precision, with distortion; all prepared that can be."""
    camera = scanner.camera
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], float)
    normal, distance = np.asarray(scanner.lasers.normal[0], np.float32), float(scanner.lasers.distance[0])
    poses = _poses(scanner, angle)
    xyz, rgb, every_u = _results(len(on))

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
        every_u[number] = np.where(valid, u, np.nan)
        return len(found)

    return Peer(lambda: sum(pool.map(one, range(len(on)))), every_u)


def _poses(scanner: Scanner, angle: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        return np.asarray(jax.jit(jax.vmap(scanner.as_dtype(np.float64).pose))(angle)).astype(np.float32)


def _results(pairs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    shape = (pairs, HEIGHT)
    return np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.uint8), np.full(shape, np.nan, np.float32)


def _fused(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Peak and centroid of each row [rows, columns], in 8 bit until 17 pixels of each are left."""
    difference = cv2.subtract(on, off)
    # The first of equals wins.
    place = difference.argmax(-1)
    first = np.clip(place - REACH, 0, WIDTH - 2 * REACH - 1)
    near = np.lib.stride_tricks.sliding_window_view(difference, 2 * REACH + 1, 1)[np.arange(len(first)), first]
    total, moment = near.sum(-1, dtype=np.float32), near @ np.arange(2 * REACH + 1, dtype=np.float32)
    u = np.where(total > 0, first + moment / np.maximum(total, 1), -1)
    return u, difference[np.arange(len(place)), place]


def fused(on: np.ndarray, off: np.ndarray, pool: ThreadPoolExecutor) -> Peer:
    """Peak and centroid of every row, with OpenCV and NumPy, on all cores."""
    u, top = np.zeros((len(on), HEIGHT), np.float32), np.zeros((len(on), HEIGHT), np.uint8)
    several = 1

    def look(start: int) -> None:
        some = slice(start, start + several)
        centre, peak = _fused(*(stack[some].reshape(-1, WIDTH) for stack in (on, off)))
        u[some], top[some] = centre.reshape(-1, HEIGHT), peak.reshape(-1, HEIGHT)

    def run() -> int:
        list(pool.map(look, range(0, len(on), several)))
        return u.size

    return Peer(run, u)


def read(on: np.ndarray, off: np.ndarray, pool: ThreadPoolExecutor) -> Callable[[], object]:
    """Add up all bytes, eight at a time, on all cores: the cost of reading the frames."""
    words = (stack.reshape(-1).view(np.uint64) for stack in (on, off))
    parts = [part for whole in words for part in np.array_split(whole, 8 * THREADS)]
    return lambda: list(pool.map(np.sum, parts))


PAIR_BYTES = 2 * WIDTH * HEIGHT
SMALL = 64
"""Pairs of a small sweep."""
PLAIN = StripeSettings(estimator="centre_of_gravity")
"""The plain estimator, beside the default one."""


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
    variants["ours, all columns"] = {"noise": noise, "settings": ReconstructSettings(gate=False)}
    return variants


def measure_memory(frames: Frames, repeats: int) -> list[Contestant]:
    """Whole pipelines and bounds on all frames."""
    pairs = len(frames.on)
    scanner, angle = make_scanner(), make_angles(pairs)
    sweep = Sweep(frames.on, frames.off, angle)
    # OpenCV's own threads would only compete with the threads over frames.
    cv2.setNumThreads(1)
    with ThreadPoolExecutor(THREADS) as pool:
        stacks = (frames.on, frames.off)
        others = {
            "horus": horus(scanner, *stacks, angle, pool),
            "usual": pipeline(usual_centres, scanner, *stacks, angle, pool),
            "lean": pipeline(lean_centres, scanner, *stacks, angle, pool),
            "fused": fused(*stacks, pool),
        }
        points: dict[str, float] = {}

        def own(name: str, options: dict[str, Any]) -> Callable[[], object]:
            def run() -> None:
                points[name] = float(reconstruct(sweep, scanner, **options).valid.mean())

            return run

        runs = {name: own(name, options) for name, options in own_variants().items()}
        runs |= {name: peer.run for name, peer in others.items()} | {"read": read(*stacks, pool)}
        times = take_turns(runs, repeats)
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
        "fused": "bound: peak and centroid alone, in 8 bit",
        "read": "bound: the bytes",
    }
    return [
        Contestant(name, gives[name], Times(*(t / pairs for t in times[name])), points.get(name), right.get(name))
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
        ("ours", "fused", "lower", 1.4),
        ("ours, noise given", "fused", "lower", None),
        ("ours", "read", "lower", None),
        ("horus", "ours", "higher", 2.0),
        ("usual", "ours", "higher", 1.0),
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


def small_figures(frames: Frames, repeats: int) -> list[Figure]:
    """A small sweep, in which a fixed time per sweep shows."""
    scanner, pairs = make_scanner(), min(SMALL, len(frames.on))
    stacks = frames.on[:pairs], frames.off[:pairs]
    sweep = Sweep(*stacks, make_angles(pairs))
    with ThreadPoolExecutor(THREADS) as pool:
        peer = fused(*stacks, pool)
        times = take_turns({"ours": lambda: reconstruct(sweep, scanner), "fused": peer.run}, 3 * repeats)
    ours, bound = times["ours"], times["fused"]
    return [
        Figure(f"{pairs} pairs", 1e3 * ours.best / pairs, "ms/pair", "lower", 0.3),
        Figure(f"{pairs} pairs: ours / fused", ours.best / bound.best, "1", "lower", 0.3, 1.9),
    ]
