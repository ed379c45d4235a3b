"""Table II: the laser's plane, by linear least squares as in (8), by total least squares, and from the joint solve.

All are from the same images, in 30 draws of noise. The first two take the paper's camera and board poses as exact;
their stripes are centres of gravity, or highest pixels. Depth errors are taken at the pixels where the true rig sees
its stripe at that depth, over all rows: they are errors of camera and plane together.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.methods import METHODS, PaperWay, points_on_sheet
from experiments.paper.products import Draw, draws, our_calibrations
from experiments.paper.stage import Metric, Stage
from experiments.paper.table_1 import AGREE, ENOUGH
from experiments.report import rms
from jaxscan.calibration import depth_sigma, stripe_depths, stripe_pixels
from jaxscan.geometry import Scanner
from jaxscan.simulation import true_scanner


DEPTHS_M = (1.3, 2.5)
"""The paper's working distance, and the distance of its wall."""
PAPER = (-7.606, -1.685, 1296.203)
COEFFICIENTS = (("a", "1"), ("b", "1"), ("c", "mm"))


class Plane(NamedTuple):
    """The plane by one method, in all draws."""

    key: str
    title: str
    abc: np.ndarray
    """a, b [1] and c [mm], [draws, 3]."""
    depth: list[np.ndarray]
    """Depth errors [mm] for each of some depths, [draws, rows]."""


def run(stage: Stage) -> list[Metric]:
    """Figures of Table II."""
    true = true_scanner(stage.config)
    drawn = draws(stage)
    scanners = [jaxscan.load_scanner(draw.ours) for draw in drawn]
    seen = {depth: stripe_pixels(true, 0, depth) for depth in DEPTHS_M}
    every = [_of_paper(drawn, fit, finder, seen) for finder in METHODS for fit in ("linear", "total")]
    every.append(_of_scanners("ours", "ours, the paper's views", scanners, seen))
    protocol = [jaxscan.load_scanner(path) for path in our_calibrations(stage)]
    own = _of_scanners("our_protocol", "ours, own protocol", protocol, seen)
    laser = stage.config.laser[0]
    truth = np.array([laser.a, laser.b, laser.c_mm], float)
    metrics = [metric for plane in every if "highest" not in plane.key for metric in _coefficients(plane, truth)]
    for at, depth in enumerate(DEPTHS_M):
        metrics += [metric for plane in every for metric in _depth(plane, depth, plane.depth[at])]
        metrics += _depth(own, depth, own.depth[at])[:1]
        sigma = float(np.sqrt(np.mean([depth_sigma(one, 0, seen[depth]) ** 2 for one in scanners])))
        name = f"{every[-1].title}: depth at {depth:g} m, predicted standard deviation"
        metrics.append(
            Metric(f"ours_depth_{_mm(depth)}_predicted", 1000 * sigma, "mm", "less", 100 * sigma, label=name)
        )
        metrics.append(_observed_over_predicted(every[-1], depth, every[-1].depth[at], 1000 * sigma))
    return [*metrics, _ours_over_paper(every)]


def _of_paper(drawn: list[Draw], fit: str, finder: str, seen: dict[float, np.ndarray]) -> Plane:
    ways = [draw.by(finder) for draw in drawn]
    planes = [getattr(way, fit) for way in ways]

    def depths(way: PaperWay, q: np.ndarray) -> np.ndarray:
        return points_on_sheet(way, q, getattr(way, fit))[..., 2]

    fits = {"linear": "linear least squares", "total": "total least squares"}
    key = f"paper_way_{fit}" if finder == "gravity" else f"paper_way_{fit}_highest"
    title = f"{METHODS[finder]}, {fits[fit]}"
    return Plane(key, title, np.array(planes) * [1, 1, 1000], _errors(ways, depths, seen))


def _of_scanners(key: str, title: str, scanners: list[Scanner], seen: dict[float, np.ndarray]) -> Plane:
    abc = []
    for scanner in scanners:
        normal, distance = np.asarray(scanner.lasers.normal)[0], float(scanner.lasers.distance[0])
        abc.append([normal[0] / normal[2], normal[1] / normal[2], 1000 * distance / normal[2]])
    return Plane(key, title, np.array(abc), _errors(scanners, lambda one, q: stripe_depths(one, 0, q), seen))


def _errors(found: list, depths: Callable, seen: dict[float, np.ndarray]) -> list[np.ndarray]:
    """Depth errors [mm] at each of the depths, [draws, rows]."""
    return [1000 * (np.array([depths(one, q) for one in found]) - depth) for depth, q in seen.items()]


def _coefficients(plane: Plane, truth: np.ndarray) -> list[Metric]:
    """Mean (beside the value of the paper's one calibration), bias and standard deviation of a, b, c."""
    metrics, ours = [], plane.key == "ours"
    less = "less" if ours else "none"
    for index, (name, unit) in enumerate(COEFFICIENTS):
        values = plane.abc[:, index]
        spread = float(values.std(ddof=1))
        of_mean, of_spread = 3 * spread / np.sqrt(len(values)), 3 * spread / np.sqrt(2 * len(values) - 2)
        key, label, near = (
            f"{plane.key}_{name}",
            f"{plane.title}: {name} of the laser's plane",
            "near" if ours else "none",
        )
        metrics += [
            Metric(f"{key}_mean", float(values.mean()), unit, near, of_mean, PAPER[index], label=f"{label}, mean"),
            Metric(f"{key}_bias", float(values.mean() - truth[index]), unit, near, of_mean, label=f"{label}, bias"),
            Metric(f"{key}_spread", spread, unit, less, of_spread, label=f"{label}, standard deviation"),
        ]
    return metrics


def _depth(plane: Plane, depth: float, errors: np.ndarray) -> list[Metric]:
    """Root mean square, bias and standard deviation of the depth error over draws and rows."""
    less, near = ("none", "none") if plane.key.startswith("paper") else ("less", "near")
    whole, bias = rms(errors), float(errors.mean())
    # Rows of a draw are not independent: a draw counts once.
    square = np.mean(errors**2, axis=1)
    of_rms = 3 * _deviation(square) / np.sqrt(len(errors)) / (2 * whole)
    of_bias = 3 * _deviation(errors.mean(1)) / np.sqrt(len(errors))
    spread = rms(errors - errors.mean(0)) * np.sqrt(len(errors) / max(len(errors) - 1, 1))
    key, label = f"{plane.key}_depth_{_mm(depth)}", f"{plane.title}: depth at {depth:g} m"
    if len(errors) < ENOUGH:
        of_rms = max(of_rms, 0.5 * whole)
    return [
        Metric(f"{key}_rms", whole, "mm", less, of_rms, label=f"{label}, rms error"),
        Metric(f"{key}_bias", bias, "mm", near, of_bias, label=f"{label}, bias"),
        Metric(f"{key}_spread", float(spread), "mm", less, of_rms, label=f"{label}, standard deviation"),
    ]


def _observed_over_predicted(plane: Plane, depth: float, errors: np.ndarray, sigma_mm: float) -> Metric:
    """Root mean square depth error over the predicted standard deviation, both over draws and rows."""
    ratio, square = rms(errors) / sigma_mm, np.mean(errors**2, axis=1)
    error = _deviation(square) / np.sqrt(len(square)) / (2 * rms(errors) * sigma_mm)
    limits = AGREE if len(errors) >= ENOUGH else (None, None)
    label = f"{plane.title}: depth at {depth:g} m, rms error over predicted standard deviation, ± {error:.2g}"
    key = f"{plane.key}_depth_{_mm(depth)}_error_over_predicted"
    return Metric(key, ratio, "1", "near", 3 * error, None, *limits, label)


def _ours_over_paper(every: list[Plane]) -> Metric:
    """Our whole method over the paper's: the better fit with the better stripe finder."""
    error = {plane.key: rms(plane.depth[DEPTHS_M.index(2.5)]) for plane in every}
    ratio = error["ours"] / min(value for key, value in error.items() if key.startswith("paper_way"))
    label = "ours over the best fit of the paper's method, the paper's views: rms depth error at 2.5 m"
    return Metric("ours_over_paper_way", ratio, "1", "less", 0.5 * ratio, label=label)


def _mm(depth: float) -> str:
    return f"{1000 * depth:.0f}"


def _deviation(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else 0.0
