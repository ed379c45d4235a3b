"""Table I and Tr: the paper's protocol, by its method and by ours on the same images, with 30 draws of noise.

The paper's method is sequential: Zhang's camera with one radial coefficient, the plane by linear least squares, Tr from
the last two views, the motion at step n as Trⁿ. Ours is one joint solve with an explicit axis. The third series is our
own protocol with many lit views and wider turns.

A length across 180 degrees is found by carrying two opposite points into one frame. Their pixels come from the true
rig, without noise: its error is that of the calibration alone.
"""

import numpy as np

import jaxscan
from experiments.paper.methods.plain_stripes import METHODS
from experiments.paper.metrics import Metric
from experiments.paper.products.draws import draws, our_calibrations
from experiments.paper.stage import Stage
from experiments.paper.tables.honesty import AGREE, ENOUGH, Honesty, compare
from experiments.paper.tables.pictures import Series, strips
from experiments.paper.tables.quantities import (
    QUANTITIES,
    Quantity,
    across_half_a_turn,
    of_paper_way,
    of_scanner,
    true_values,
)
from jaxscan.calibration import Length, length_sigma
from jaxscan.geometry import Scanner


NAMES = {
    "paper_way": METHODS["gravity"],
    "ours": "ours, the paper's views",
    "our_protocol": "ours, own protocol",
}


def run(stage: Stage) -> list[Metric]:
    """Figures and picture of Table I."""
    lengths = across_half_a_turn(stage.config)
    true = true_values(stage.config, lengths)
    drawn = draws(stage)
    scanners = [jaxscan.load_scanner(draw.ours) for draw in drawn]
    protocol = [jaxscan.load_scanner(path) for path in our_calibrations(stage)]
    found = {
        "paper_way": np.array([of_paper_way(draw.paper, lengths) for draw in drawn]),
        "ours": np.array([of_scanner(scanner, lengths) for scanner in scanners]),
        "our_protocol": np.array([of_scanner(scanner, lengths) for scanner in protocol]),
    }
    honesty = compare(scanners, stage.config)
    labels = [f"{one.title} [{one.unit}]" if one.unit != "1" else one.title for one in QUANTITIES]
    series = [
        Series(NAMES[key], found[key] - true, colour)
        for key, colour in zip(NAMES, ("tab:red", "tab:blue", "tab:green"), strict=True)
    ]
    title = (
        f"Table I, {stage.world} world: errors in {len(drawn)} draws of noise (line: mean; box: ± standard deviation)"
    )
    strips(series, labels, title, stage.picture("table_1"))
    return [
        *(metric for way in ("paper_way", "ours") for metric in _spreads(way, found[way], true, full=not stage.quick)),
        *_predicted("ours", scanners, lengths),
        *_lengths_over_predicted(scanners, found["ours"] - true, lengths),
        *_predicted("our_protocol", protocol, lengths),
        *_protocol_errors(found["our_protocol"], true),
        *_honesty(honesty, len(drawn)),
        Metric("draws_failed", stage.draws - len(drawn), "", "less", 0.0, high=0.0,
               label=f"draws that one of both methods cannot calibrate, of {stage.draws}"),
    ]  # fmt: skip


def _spreads(way: str, found: np.ndarray, true: np.ndarray, *, full: bool) -> list[Metric]:
    """Mean (if `full`, where the paper has a value), bias and standard deviation of each quantity."""
    count, metrics = len(found), []
    for quantity, values, truth in zip(QUANTITIES, found.T, true, strict=True):
        spread = float(values.std(ddof=1))
        of_mean, of_spread = 3 * spread / np.sqrt(count), 3 * spread / np.sqrt(2 * count - 2)
        label, near = f"{NAMES[way]}: {quantity.title}", "near" if way == "ours" else "none"
        key = f"{way}_{quantity.key}"
        if full and quantity.paper is not None:
            mean = Metric(f"{key}_mean", float(values.mean()), quantity.unit, near, of_mean, quantity.paper)
            metrics.append(mean._replace(label=f"{label}, mean of {count} draws"))
        bias, less = float(values.mean() - truth), "less" if way == "ours" else "none"
        metrics += [
            Metric(f"{key}_bias", bias, quantity.unit, near, of_mean, label=f"{label}, bias"),
            Metric(f"{key}_spread", spread, quantity.unit, less, of_spread, label=f"{label}, standard deviation"),
        ]
    return metrics


def _predicted(key: str, scanners: list[Scanner], lengths: list[Length]) -> list[Metric]:
    """Standard deviations of the lengths, predicted by the covariance."""
    sigma = 1000 * np.sqrt(np.mean([length_sigma(scanner, lengths) ** 2 for scanner in scanners], axis=0))
    return [
        Metric(f"{key}_{one.key}_predicted", float(value), "mm", "less", 0.1 * float(value),
               label=f"{NAMES[key]}: {one.title}, predicted standard deviation")
        for one, value in zip(_lengths(), sigma, strict=True)
    ]  # fmt: skip


def _lengths_over_predicted(scanners: list[Scanner], errors: np.ndarray, lengths: list[Length]) -> list[Metric]:
    """Root mean square errors of the lengths over their predicted standard deviations; a bias counts.

    Args:
        scanners: One for each draw.
        errors: Of all quantities, in their units [draws, quantities].
        lengths: Those of `across_half_a_turn`.
    """
    sigma = 1000 * np.array([length_sigma(scanner, lengths) for scanner in scanners])
    limits = AGREE if len(scanners) >= ENOUGH else (None, None)
    metrics = []
    for index, one in enumerate(_lengths()):
        squares = (errors[:, QUANTITIES.index(one)] / sigma[:, index]) ** 2
        ratio = float(np.sqrt(squares.mean()))
        error = float(squares.std(ddof=1) / np.sqrt(len(squares)) / (2 * ratio))
        label = f"{NAMES['ours']}: {one.title}, rms error over predicted standard deviation, ± {error:.2g}"
        metrics.append(
            Metric(f"ours_{one.key}_error_over_predicted", ratio, "1", "near", 3 * error, None, *limits, label)
        )
    return metrics


def _protocol_errors(found: np.ndarray, true: np.ndarray) -> list[Metric]:
    """Root mean square errors of the few calibrations by our own protocol."""
    rms = np.sqrt(np.mean((found - true) ** 2, axis=0))
    return [
        Metric(f"our_protocol_{one.key}_rms", float(value), one.unit, "less", 0.5 * float(value),
               label=f"{NAMES['our_protocol']}: {one.title}, rms error, {len(found)} calibrations")
        for one, value in zip(QUANTITIES, rms, strict=True)
    ]  # fmt: skip


def _honesty(honesty: Honesty, count: int) -> list[Metric]:
    """Observed errors over predicted ones.

    The covariance includes unknowns that only their priors determine; they are the same in all draws. So the ratio of
    the spread alone may be below 1.
    """
    limits = AGREE if count >= ENOUGH else (None, None)
    name, of = NAMES["ours"], f"{len(honesty.names)} parameters, {count} draws"
    return [
        Metric("ours_error_over_predicted", honesty.pooled, "1", "near", 3 * honesty.pooled_error, None, *limits,
               f"{name}: rms error over predicted standard deviation, {of}, ± {honesty.pooled_error:.2g}"),
        Metric("ours_spread_over_predicted", honesty.spread, "1", "near", 3 * honesty.spread_error,
               label=f"{name}: observed over predicted standard deviation, {of}, ± {honesty.spread_error:.2g}"),
        Metric("ours_squared_error_over_predicted", honesty.squared, "1", "near", 3 * honesty.squared_error,
               label=f"{name}: squared error normalised by the covariance, {of}, ± {honesty.squared_error:.2g}"),
    ]  # fmt: skip


def _lengths() -> list[Quantity]:
    return [one for one in QUANTITIES if one.key.startswith("length")]
