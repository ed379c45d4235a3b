"""Table I and Tr: the paper's protocol, by its method and by ours on the same images, with 30 draws of noise.

The paper's method is sequential: Zhang's camera with one radial coefficient, the plane by linear least squares, Tr from
the last two views, the motion at step n as Trⁿ. Ours is one joint solve with an explicit axis. The third series is our
own protocol with many lit views and wider turns.

A length across 180 degrees is found by carrying two opposite points into one frame. Their pixels come from the true
rig, without noise: its error is that of the calibration alone.
"""

from typing import NamedTuple

import jax
import numpy as np

import jaxscan
from experiments.exact_rig import errors, to_true_tangents
from experiments.paper.methods import METHODS, PaperWay, points_on_sheet, power
from experiments.paper.products import PAIR_DEG, draws, our_calibrations
from experiments.paper.stage import Metric, Stage
from jaxscan.calibration import Length, length_sigma, measure_lengths, stripe_pixels
from jaxscan.geometry import Scanner, Turntable
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.simulation import SimulationConfig, true_scanner


WALLS_M = (3.82, 6.15)
"""Distances of opposite walls of the paper's room."""


class Quantity(NamedTuple):
    """A number of Table I, or one derived from it."""

    key: str
    title: str
    unit: str
    paper: float | None = None
    """As the paper reports it, or as it follows from its Tr."""


QUANTITIES = (
    Quantity("fx", "focal length α", "px", 2894.462),
    Quantity("fy", "focal length β", "px", 2887.338),
    Quantity("cx", "principal point u0", "px", 1016.814),
    Quantity("cy", "principal point v0", "px", 817.261),
    Quantity("k1", "radial coefficient k", "1"),
    Quantity("turn", "turn of Tr", "deg", 1.98),
    Quantity("axis_distance", "distance of the axis from the camera", "mm", 212.5),
    Quantity("axis_sideways", "tilt of the axis sideways", "deg"),
    Quantity("axis_forwards", "tilt of the axis forwards", "deg"),
    Quantity("length_3820", "a length of 3.82 m across 180°", "mm"),
    Quantity("length_6150", "a length of 6.15 m across 180°", "mm"),
)


def across_half_a_turn(config: SimulationConfig) -> list[Length]:
    """Lengths from one wall to the opposite one, in the middle of the image, at the pixels of the true rig.

    No noise of a sweep takes part, so that an error of the length is the calibration's alone.
    """
    true = true_scanner(config)
    found = []
    for wall in WALLS_M:
        depths = np.linspace(0.4, 0.6, 11) * wall
        lengths = [_half_turn(true, depth) for depth in depths]
        found.append(_half_turn(true, float(np.interp(wall, measure_lengths(true, lengths), depths))))
    return found


def of_scanner(scanner: Scanner, lengths: list[Length]) -> np.ndarray:
    """`QUANTITIES` of a calibration, in their units."""
    table = scanner.turntable
    if not isinstance(table, Turntable):
        raise TypeError("A calibration with a turntable is needed.")
    with jax.enable_x64(True):
        camera = dict(zip(scanner.camera.parameter_names(), np.asarray(scanner.camera.parameters()), strict=True))
        turn = np.rad2deg(float(table.angle(np.asarray(np.deg2rad(PAIR_DEG)))))
    lens = [camera[name] for name in ("fx", "fy", "cx", "cy", "k1")]
    return np.array([*lens, abs(turn), *_axis_of(table), *(1000 * measure_lengths(scanner, lengths))])


def of_paper_way(way: PaperWay, lengths: list[Length]) -> np.ndarray:
    """`QUANTITIES` of a calibration by the paper's method, in their units."""
    table = Turntable.from_tr(way.tr)
    # The axis points to the upper side of the image, as in all calibrations.
    table = table.pointed(np.array([0.0, -1.0, 0.0]))
    turn = np.rad2deg(np.arccos(np.clip((np.trace(way.tr[:3, :3]) - 1) / 2, -1, 1)))
    matrix = way.matrix
    lens = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], way.k]
    return np.array([*lens, turn, *_axis_of(table), *(1000 * _paper_length(way, length) for length in lengths)])


def true_values(config: SimulationConfig, lengths: list[Length]) -> np.ndarray:
    """`QUANTITIES` of the true rig."""
    return of_scanner(true_scanner(config), lengths)


def _half_turn(scanner: Scanner, depth: float) -> Length:
    q = stripe_pixels(scanner, 0, depth)
    return Length("half a turn", depth, 0, np.tile(q[len(q) // 2], (2, 1)), np.array([0.0, np.pi]))


def _axis_of(table: Turntable) -> tuple[float, float, float]:
    """Distance from the camera [mm], and tilts against the image's columns, sideways and forwards [deg]."""
    x, y, z = np.asarray(table.direction)
    return 1000 * float(np.linalg.norm(table.point)), *(float(np.rad2deg(np.arctan2(part, -y))) for part in (x, z))


def _paper_length(way: PaperWay, length: Length) -> float:
    points = points_on_sheet(way, length.q)
    motion = power(way.tr, length.angle / way.pair_angle)
    ends = np.einsum("nij,nj->ni", motion[:, :3, :3], points) + motion[:, :3, 3]
    return float(np.linalg.norm(ends[1] - ends[0]))


AGREE = 0.8, 1.2
"""Observed over predicted errors must lie between these."""
ENOUGH = 10
"""Fewest draws for that limit: with fewer, the standard error of a spread is over 20 %."""


class Honesty(NamedTuple):
    """Errors over their predicted standard deviations."""

    names: tuple[str, ...]
    """Parameters that are compared."""
    pooled: float
    """Root mean square of errors about the truth, each over its predicted standard deviation; a bias counts."""
    pooled_error: float
    """Its standard error from draw to draw, without a bias that all draws share."""
    spread: float
    """The same about the mean of the draws."""
    spread_error: float
    squared: float
    """Mean of e' C⁻¹ e per parameter, errors about the truth; 1 is expected."""
    squared_error: float


def compare_honesty(scanners: list[Scanner], config: SimulationConfig) -> Honesty:
    """Compare calibrations of independent draws.

    Held parameters are left out, and those of the table's angle: a few degrees hardly determine them, so their
    predicted errors are those of their priors, from which the true rig was not drawn.
    """
    names = scanners[0].parameter_names()
    turned = [to_true_tangents(scanner, config) for scanner in scanners]
    error = np.array([turn @ errors(scanner, config) for turn, scanner in zip(turned, scanners, strict=True)])
    covariance = np.array(
        [turn @ np.asarray(one.covariance) @ turn.T for turn, one in zip(turned, scanners, strict=True)]
    )
    free = (np.diagonal(covariance, axis1=1, axis2=2) > 0).all(0)
    free &= np.array([name not in ANGLE_PARAMETERS for name in names])
    error, covariance = error[:, free], covariance[:, free][:, :, free]
    squared = np.array([e @ np.linalg.solve(c, e) for e, c in zip(error, covariance, strict=True)]) / error.shape[1]
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    count = len(error)
    return Honesty(
        tuple(np.array(names)[free]),
        *_root_mean_square(error**2 / variance),
        *_root_mean_square((error - error.mean(0)) ** 2 / variance * count / (count - 1)),
        float(squared.mean()),
        float(squared.std(ddof=1) / np.sqrt(count)),
    )


def _root_mean_square(squares: np.ndarray) -> tuple[float, float]:
    """Of squares [draws, parameters], with its standard error; draws are independent, parameters are not."""
    root = float(np.sqrt(squares.mean()))
    return root, float(squares.mean(1).std(ddof=1) / np.sqrt(len(squares)) / (2 * root))


NAMES = {"paper_way": METHODS["gravity"], "ours": "ours, the paper's views", "our_protocol": "ours, own protocol"}


def run(stage: Stage) -> list[Metric]:
    """Figures of Table I."""
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
    honesty = compare_honesty(scanners, stage.config)
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
        errors: Errors of all quantities, in their units [draws, quantities].
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
