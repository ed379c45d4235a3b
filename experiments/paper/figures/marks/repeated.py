"""The random part of distances between marks: what other noise of the same frames changes, against the prediction.

An edge of a mark moves the stripe that lies over it, always in the same way. The sigmas of the cloud count this as if
it were chance (`StripeSettings.guard_edges`). For the part of chance alone the prediction is made without it, and
compared with a repeated sweep. With it, the prediction is too large for marks: their two sides move against each other.
"""

from collections.abc import Callable

import numpy as np

import jaxscan
from experiments.paper.figures.marks.measure import Measured, measure_ours
from experiments.paper.metrics import Metric
from jaxscan.reconstruction import SweepSource
from jaxscan.stripes import NoiseModel


_UNGUARDED = jaxscan.ReconstructSettings(stripes=jaxscan.StripeSettings(guard_edges=False))


class Kept:
    """Frames of the first records of a sweep, kept while it is read."""

    def __init__(self, count: int, also: Callable[[int, np.ndarray, np.ndarray], None] | None = None) -> None:
        """Of `count` records; `also` sees all frames."""
        self.count, self.also = count, also
        self.frames: list[np.ndarray] = []

    def __call__(self, first: int, on: np.ndarray, off: np.ndarray) -> None:
        """Keep a chunk."""
        if self.also is not None:
            self.also(first, on, off)
        if not self.frames:
            self.frames = [np.zeros((self.count, *on.shape[1:]), np.uint8) for _ in range(2)]
        for whole, part in zip(self.frames, (on, off), strict=True):
            whole[first : first + len(part)] = part[: max(0, self.count - first)]

    def sweep(self, source: SweepSource) -> jaxscan.Sweep:
        """As a sweep in memory, of the kind of the one they are from."""
        on, off = self.frames
        alike = {name: getattr(source, name) for name in ("pixel_format", "response", "lasers")}
        return jaxscan.Sweep(on, off, source.angles[: self.count], carries="scanner", **alike)


def random_part(
    sweeps: tuple[SweepSource, SweepSource], scanner: jaxscan.Scanner, noise: NoiseModel, guarded: Measured
) -> list[Metric]:
    """Compare two sweeps that differ in noise alone.

    Args:
        sweeps: Both, of the same angles.
        scanner: The calibration.
        noise: Of a frame.
        guarded: Distances of the whole sweep with the sigmas as they are.
    """
    clouds = [jaxscan.reconstruct(sweep, scanner, settings=_UNGUARDED, noise=noise) for sweep in sweeps]
    one, two = (measure_ours(cloud, scanner, noise) for cloud in clouds)
    first, second = _same(one, two)
    observed = float(np.std(two.distances[second] - one.distances[first]) / np.sqrt(2)) if len(first) > 1 else np.nan
    expected = _mean(one.predicted()[first])
    cautious = _mean(guarded.predicted())
    spread, label = float(np.std(guarded.distances)), "random part, observed over predicted"
    return [
        Metric("ours_random_std", observed, "mm", "less", 0.03, label="random part of the standard deviation"),
        Metric(
            "ours_predicted_std", expected, "mm", "near", 0.03, label="the same as predicted from the points' noise"
        ),
        Metric("ours_random_over_predicted", observed / expected, "", "near", 0.25, None, 0.8, 1.2, label),
        Metric(
            "ours_guarded_std", cautious, "mm", "none", label="standard deviation predicted with the guard of edges"
        ),
        Metric("ours_std_over_guarded", spread / cautious, "", "none", label="whole standard deviation over it"),
    ]


def _mean(sigma: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(sigma)))) if len(sigma) else np.nan


def _same(one: Measured, two: Measured) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the pairs that both clouds have. Each has a plane, and so coordinates, of its own."""
    shift = _shift(one.centres.place[:, :2], two.centres.place[:, :2])
    middles = [each.centres.place[each.numbers, :2].mean(1) for each in (one, two)]
    apart = np.linalg.norm(middles[0][:, None] - middles[1] - shift, axis=-1)
    return np.nonzero((apart < 0.02) & (one.beside[:, None] == two.beside))


def _shift(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """That which brings most of `others` [n, 2] onto places [m, 2] of the same grid of marks."""
    every = (places[:, None] - others).reshape(-1, 2)
    near = np.linalg.norm(every[:, None] - every, axis=-1) < 0.01
    return every[near[np.argmax(near.sum(1))]].mean(0)
