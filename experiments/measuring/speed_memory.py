"""Whole pipelines on stacks in memory, for `speed.py`: ours, others and the least work, in turn."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
from measuring import speed_peers as peers
from measuring.speed_times import Contestant, Figure, Times, take_turns
from worlds.speed_scene import DISTINCT, ELECTRONS_PER_DN, HEIGHT, READ_DN, WIDTH, Frames, make_angles, make_scanner

from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import NoiseModel, StripeSettings, extract_stripes


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
    with ThreadPoolExecutor(peers.THREADS) as pool:
        fused = peers.fused(*stacks, pool)
        times = take_turns({"ours": lambda: reconstruct(sweep, scanner), "fused": fused.run}, 3 * repeats)
    ours, bound = times["ours"], times["fused"]
    return [
        Figure(f"{pairs} pairs", 1e3 * ours.best / pairs, "ms/pair", "lower", 0.3),
        Figure(f"{pairs} pairs: ours / fused", ours.best / bound.best, "1", "lower", 0.3, 1.9),
    ]
