"""The random part of distances between marks: two sweeps that differ in noise alone, against the prediction.

An edge of a mark displaces the stripe on it by the same amount in every frame. The cloud's sigmas include this
displacement as if it were random (`StripeSettings.guard_edges`). For the random part the prediction is made without it,
and compared with a repeated sweep. With it, the prediction is too large for marks, whose two sides are displaced
against each other.
"""

from collections.abc import Callable

import numpy as np

import jaxscan
from experiments.paper.figures.marks.measure import Measured, measure_ours
from experiments.paper.metrics import Metric, rms
from jaxscan.reconstruction import SweepSource
from jaxscan.stripes import NoiseModel


_UNGUARDED = jaxscan.ReconstructSettings(stripes=jaxscan.StripeSettings(guard_edges=False))


class Kept:
    """Keeps the frames of the first records of a sweep while it is read."""

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
        """The kept frames as a sweep in memory, with the camera and laser of `source`."""
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
    expected = rms(one.predicted()[first])
    cautious = rms(guarded.predicted())
    spread = float(np.std(guarded.distances))
    random, without = "ours: standard deviation of distances by noise alone", "without the guard of edges"
    return [
        Metric("ours_random_std", observed, "mm", "less", 0.03, label=f"{random}, from a repeated sweep"),
        Metric("ours_predicted_std", expected, "mm", "near", 0.03, label=f"{random}, predicted {without}"),
        Metric("ours_random_over_predicted", observed / expected, "1", "near", 0.25, None, 0.8, 1.2,
               f"{random}, observed over predicted {without}"),
        Metric("ours_guarded_std", cautious, "mm", "none",
               label="ours: standard deviation of distances, predicted with the guard of edges"),
        Metric("ours_std_over_guarded", spread / cautious, "1", "none",
               label="ours: standard deviation of distances over the prediction with the guard of edges"),
    ]  # fmt: skip


def _same(one: Measured, two: Measured) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the pairs that both clouds have. Each cloud has coordinates of its own plane."""
    shift = _shift(one.centres.place[:, :2], two.centres.place[:, :2])
    middles = [each.centres.place[each.numbers, :2].mean(1) for each in (one, two)]
    apart = np.linalg.norm(middles[0][:, None] - middles[1] - shift, axis=-1)
    return np.nonzero((apart < 0.02) & (one.beside[:, None] == two.beside))


def _shift(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The shift that brings most of `others` [n, 2] onto `places` [m, 2] of the same grid of marks [m]."""
    every = (places[:, None] - others).reshape(-1, 2)
    near = np.linalg.norm(every[:, None] - every, axis=-1) < 0.01
    return every[near[np.argmax(near.sum(1))]].mean(0)
