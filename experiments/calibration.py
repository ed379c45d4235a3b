"""Are the stated sigmas of a calibration those of its errors? Boards as equations give them: no image is rendered.

    python -m experiments.calibration [--runs N] [--quick] [--json FILE]

Errors of hundreds of calibrations with fresh noise against the covariance that each states. Gain and harmonics of the
table are held by their priors alone, so their true values, and the ratio of the focal lengths, are drawn from the
priors in every run. The exit code is 1 if a limit is missed.
"""

import sys
import time
from typing import NamedTuple

import numpy as np

from experiments import exact_rig
from experiments.exact_rig import BoardPoses, PosePlan, add_noise, draw_poses, ideal_boards
from experiments.report import Figure, command_line, conclude, progress, rms
from jaxscan.calibration import Length, calibrate_observations, length_sigma, measure_lengths, typical_lengths
from jaxscan.simulation import SimulationConfig, true_scanner


WALLS_MM = {1.91: 1.1, 3.075: 1.7}
"""Depth of opposite walls, m, and the most that the standard deviation of their distance may be."""
POSE_SEED = 7
POSES = PosePlan(free_views=30, placements=4, angles=9)
"""Thirty board views, and four placements seen at nine table angles each, all with a stripe."""


class Run(NamedTuple):
    """One calibration; parameters are those of the scanner, then the board's."""

    error: np.ndarray
    covariance: np.ndarray
    length_error: np.ndarray
    length_sigma: np.ndarray
    chi2: tuple[float, float]
    """Squares of whitened corner and stripe residuals per degree of freedom."""
    counts: tuple[int, int]
    rejected: int


def honesty(runs: int, quick: bool) -> list[Figure]:
    """Compares errors with stated sigmas, for white and for correlated noise of the stripes."""
    config = exact_rig.reference()
    poses = draw_poses(config, POSE_SEED, POSES)
    scanner = true_scanner(config)
    lengths = typical_lengths(scanner, 0)
    names = (*scanner.parameter_names(), "warp.x", "warp.y", "pitch")
    figures: list[Figure] = []
    for label, correlation in exact_rig.CORRELATIONS.items():
        started, found = time.perf_counter(), []
        for seed in range(runs):
            found.append(_calibrated(config, poses, lengths, seed, correlation))
            if seed % 20 == 0:
                progress(f"{label}: {seed + 1} of {runs} runs, {time.perf_counter() - started:.0f} s")
        # Few runs know a standard deviation badly: at 12, four times 1 / sqrt(24) = 0.8.
        figures += _honest(label, found, names, lengths, 5.0 if quick else 1.0)
    return figures


def _calibrated(
    config: SimulationConfig, poses: BoardPoses, lengths: list[Length], seed: int, correlation: float
) -> Run:
    """Draw a truth and noise, calibrate, compare."""
    random = np.random.default_rng([17, seed])
    truth = exact_rig.drawn(config, random)
    noisy = add_noise(ideal_boards(truth, poses), random, correlation=correlation)
    result = calibrate_observations(exact_rig.observations(noisy, truth), settings=exact_rig.SETTINGS)
    quality, fit = result.quality, result.fit
    board = np.append(fit.warp - np.array(truth.boards.warp_mm) / 1000, fit.pitch)
    turned = np.eye(len(fit.covariance))
    count = len(result.order)
    turned[:count, :count] = exact_rig.to_true_tangents(result.scanner, truth)
    return Run(
        turned @ np.concatenate([exact_rig.errors(result.scanner, truth), board]),
        turned @ fit.covariance @ turned.T,
        measure_lengths(result.scanner, lengths) - measure_lengths(true_scanner(truth), lengths),
        length_sigma(result.scanner, lengths),
        (quality.corner_rms_whitened**2, quality.stripe_rms_whitened**2),
        (2 * quality.corners, quality.stripe_points),
        quality.corners_rejected + quality.stripe_points_rejected,
    )


def _honest(label: str, runs: list[Run], names: tuple[str, ...], lengths: list[Length], wide: float) -> list[Figure]:
    """All figures of one kind of noise; `wide` opens the bounds for small numbers of runs."""
    error = np.array([each.error for each in runs])
    covariance = np.array([each.covariance for each in runs])
    free = np.diag(runs[0].covariance) > 0
    error, covariance = error[:, free], covariance[:, free][:, :, free]
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    count, size = error.shape
    # Each error against the sigma of its own run: truths differ, and so do the covariances a little.
    # About zero and not about the mean, so that a bias counts against us.
    ratio = np.sqrt(np.mean((error / sigma) ** 2, axis=0))
    inside = np.abs(error) <= 1.96 * sigma
    nees = np.array([e @ np.linalg.solve(c, e) for e, c in zip(error, covariance, strict=True)])
    band = 3 * np.sqrt(2 * size / count)
    low, high = 1 - 0.15 * wide, 1 + 0.15 * wide
    figures = []
    for name, value in zip(np.array(names)[free], ratio, strict=True):
        figures.append(Figure(f"{label}: {name}, sample over predicted", value, "", low, high))
    length_error = 1e3 * np.array([each.length_error for each in runs])
    length_sigma = 1e3 * np.array([each.length_sigma for each in runs])
    for index, length in enumerate(lengths):
        title = f"{label}: {length.name} at {length.depth:g} m"
        found, stated = (rms(values[:, index]) for values in (length_error, length_sigma))
        most = WALLS_MM.get(length.depth) if length.name == "half a turn" else None
        figures += [
            Figure(f"{title}, predicted", stated, "mm", high=most),
            Figure(f"{title}, sample", found, "mm", high=most if wide == 1 or most is None else most * high),
            Figure(f"{title}, sample over predicted", found / stated, "", low, high),
        ]
    weights = np.array(runs[0].counts, float)
    chi2 = np.mean([each.chi2 for each in runs], axis=0)
    coverage = 100 * inside.mean(0)
    bias = np.abs(error.mean(0)) / sigma.mean(0)
    return [
        *figures,
        Figure(f"{label}: NEES, mean of {size} expected", nees.mean(), "", size - band, size + band),
        Figure(f"{label}: chi2 per degree of freedom", weights @ chi2 / weights.sum(), "", 0.97, 1.03),
        Figure(f"{label}: chi2 of corners", chi2[0], ""),
        Figure(f"{label}: chi2 of stripes", chi2[1], ""),
        Figure(f"{label}: 95 % intervals cover, all", coverage.mean(), "%", 95 - 3 * wide, min(95 + 3 * wide, 100)),
        Figure(f"{label}: 95 % intervals cover, worst", coverage.min(), "%", 89 if wide == 1 else 65),
        Figure(f"{label}: largest bias", bias.max(), "sigma"),
        Figure(f"{label}: residuals rejected per run", np.mean([each.rejected for each in runs]), ""),
    ]


def main() -> int:
    """The command."""
    parser = command_line(__doc__, quick="few runs: shows that all of it works, not how exact it is", json=True)
    parser.add_argument("--runs", type=int, help="calibrations with each kind of noise")
    options = parser.parse_args()
    figures = honesty(options.runs or (12 if options.quick else 200), options.quick)
    return conclude("calibration-honesty", figures, options.json)


if __name__ == "__main__":
    sys.exit(main())
