"""What a calibration is worth, from boards as equations give them: no image is rendered.

    python -m experiments.calibration honesty|joint|outliers [--runs N] [--quick] [--json FILE]

- honesty: errors of hundreds of calibrations with fresh noise against the covariance that each states. Gain and
  harmonics of the table are held by their priors alone, so their true values, and the ratio of the focal lengths, are
  drawn from the priors in every run. The share of the priors in all other parameters is printed; it is close to zero.
- joint: depth error of the laser plane at 2.5 m, one joint solve against the usual sequence on the same data. The
  sequence solves the camera from corners alone, lifts the stripe points to their boards, and fits a plane: by total
  least squares and as a X + b Y + Z = c, of which the better one counts. Its camera and poses come from our solve
  without stripes, with the same priors and the board's bow, and the joint solve holds the sheet's bow at 0, because a
  fitted plane has none: only the sequence differs.
- outliers: 3 % of the corners and 10 % of the stripe points are wrong by 3 to 50 px; each draw is calibrated with and
  without them.

The exit code is 1 if a limit is missed. `--quick` takes few runs: it shows that all of it works, not how exact it is.
"""

import sys
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from experiments import exact_rig
from experiments.exact_rig import BoardPoses, IdealBoards, PosePlan, add_noise, draw_poses, ideal_boards
from experiments.plain import principal_axes
from experiments.report import Figure, command_line, conclude, progress, rms
from jaxscan.calibration import (
    USUALLY_FREE,
    Calibration,
    Length,
    calibrate_camera,
    calibrate_observations,
    depth_sigma,
    length_sigma,
    measure_lengths,
    stripe_depths,
    stripe_pixels,
    typical_lengths,
)
from jaxscan.geometry import LaserSheet, Scanner, Turntable, stack_lasers
from jaxscan.observation import Observations
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
        shares = _prior_shares(found[0].covariance, names)
        progress("information from priors: " + ", ".join(f"{name} {share:.1e}" for name, share in shares.items()))
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


def _prior_shares(covariance: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    """Posterior over prior variance: how much of a parameter's information the prior is at most."""
    priors = exact_rig.SETTINGS.priors
    sigma = dict.fromkeys(("cx", "cy"), priors["centre_px"]) | dict.fromkeys(("p1", "p2"), priors["tangential"])
    sigma |= {"k3": priors["k3"], "gain": priors["gain"]} | dict.fromkeys(("c1", "s1", "c2", "s2"), priors["harmonics"])
    sigma |= dict.fromkeys(("warp.x", "warp.y"), priors["warp"])
    return {name: float(covariance[i, i] / sigma[name] ** 2) for i, name in enumerate(names) if name in sigma}


DEPTH_M = 2.5
CASES = {"4 of 23": (23, 4, 0.85), "30 of 30": (30, 30, 0.65)}
"""Views, views with a stripe, and the most that the joint error may be of the sequential one."""
POSE_SETS = 5
PLANE = replace(exact_rig.SETTINGS, free=tuple(block for block in USUALLY_FREE if block != "bow"))
"""A sheet without a bow."""


class Errors(NamedTuple):
    """Depth errors of one draw, root mean squares over all rows of the image [m]."""

    joint: float
    predicted: float
    total: float
    """Sequential, by total least squares."""
    linear: float
    """Sequential, by a X + b Y + Z = c."""


def joint(runs: int, quick: bool) -> list[Figure]:
    """Compares both solves on `runs` draws of noise of each set of poses; all sets and draws count alike."""
    config = exact_rig.reference()
    q = stripe_pixels(true_scanner(config), 0, DEPTH_M)
    sets, figures = 2 if quick else POSE_SETS, []
    for name, (views, stripes, most) in CASES.items():
        started, found = time.perf_counter(), {noise: [] for noise in exact_rig.CORRELATIONS}
        for number in range(sets):
            ideal = ideal_boards(config, _joint_poses(config, views, stripes, 100 + number))
            for draw in range(runs):
                alone = None
                for noise, correlation in exact_rig.CORRELATIONS.items():
                    # The same corners for both: stripes draw their noise after them.
                    noisy = add_noise(ideal, np.random.default_rng([number, draw]), correlation=correlation)
                    observed = exact_rig.observations(noisy, config)
                    alone = alone or calibrate_camera(observed, settings=exact_rig.SETTINGS)
                    found[noise].append(_depth_errors(observed, alone, q))
            progress(f"{name}: pose set {number + 1} of {sets}, {time.perf_counter() - started:.0f} s")
        for noise, every in found.items():
            errors = Errors(*np.array(every).T)
            best = min(errors.total.mean(), errors.linear.mean())
            ratio = np.sqrt(np.mean(errors.joint**2) / np.mean(errors.predicted**2))
            squares = errors.joint**2
            # The errors of all rows of a draw hang together, so a draw counts as one observation.
            of_ratio = float(squares.std() / squares.mean() / np.sqrt(len(squares)) / 2)
            label = f"{name}, {noise}"
            # Of two pose sets with three draws only so much can be said: joint is no worse.
            bounds = (0.3, 2.0) if quick else (0.85, 1.15)
            figures += [
                Figure(f"{label}: joint", 1e3 * errors.joint.mean(), "mm"),
                Figure(f"{label}: sequential, total least squares", 1e3 * errors.total.mean(), "mm"),
                Figure(f"{label}: sequential, linear", 1e3 * errors.linear.mean(), "mm"),
                Figure(f"{label}: joint over sequential", errors.joint.mean() / best, "", high=1.0 if quick else most),
                Figure(f"{label}: joint over predicted (root mean square)", ratio, "", *bounds),
                Figure(f"{label}: its standard error", of_ratio, ""),
            ]
    return figures


def _joint_poses(config: SimulationConfig, views: int, stripes: int, seed: int) -> BoardPoses:
    """So many views; the last two show one board before and after a turn of 10 degrees, which the joint solve needs."""
    free = views - 2
    plan = PosePlan(free_views=free, placements=1, angles=2, span_deg=10.0, lit=min(stripes, free))
    poses = draw_poses(config, seed, plan)
    return poses if stripes > free else poses._replace(lit=poses.lit & (poses.placement < free))


def _depth_errors(observed: Observations, alone: Calibration, q: np.ndarray) -> Errors:
    """One draw of noise, solved jointly and after the camera alone; at the pixels where the true depth is 2.5 m."""
    error = lambda scanner: rms(stripe_depths(scanner, 0, q) - DEPTH_M)
    solved = calibrate_observations(observed, settings=PLANE).scanner
    # A plane's depth has nothing to do with the table.
    table = Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.1])
    planes = _sequential(observed, alone)
    total, linear = (error(Scanner(alone.camera, stack_lasers([sheet]), table)) for sheet in planes)
    return Errors(error(solved), rms(depth_sigma(solved, 0, q)), total, linear)


def _sequential(observed: Observations, result: Calibration) -> tuple[LaserSheet, LaserSheet]:
    """Planes by total least squares and by a linear fit, with the camera and poses of `result`."""
    camera, fit = result.camera, result.fit
    board = np.asarray(observed.board.corners())
    centre, half = (board.min(0) + board.max(0))[:2] / 2, np.ptp(board[:, :2], axis=0) / 2

    def bow(xy: np.ndarray) -> np.ndarray:
        return (1 - ((xy - centre) / half) ** 2) @ fit.warp

    rays = np.asarray(camera.unproject(np.asarray(observed.stripes.q)))
    points = []
    for row, view in enumerate(observed.stripes.view):
        rotation, shift = fit.pose[view, :3, :3], fit.pose[view, :3, 3]
        ray = rays[row][observed.stripes.valid[row]]
        height = np.zeros(len(ray))
        # On the board its own z is its bow: n . p = n . t + height.
        for _ in range(4):
            p = ray * ((rotation[:, 2] @ shift + height) / (ray @ rotation[:, 2]))[:, None]
            height = bow(((p - shift) @ rotation)[:, :2])
        points.append(p)
    p = np.concatenate(points)
    middle, (_, _, normal) = principal_axes(p)
    a, b, c = np.linalg.lstsq(np.column_stack([p[:, :2], -np.ones(len(p))]), -p[:, 2], rcond=None)[0]
    return LaserSheet.from_plane(normal, normal @ middle), LaserSheet.from_abc(a, b, c)


WRONG_CORNERS, WRONG_STRIPES = 0.03, 0.10
WRONG_PX = (3.0, 50.0)


def outliers(runs: int, quick: bool) -> list[Figure]:
    """How sigmas and errors grow when gross errors are added to the same noise."""
    config = exact_rig.reference()
    ideal = ideal_boards(config, draw_poses(config, POSE_SEED, POSES))
    names = true_scanner(config).parameter_names()
    found: dict[str, list] = {"clean": [], "both sides": [], "one side": []}
    started = time.perf_counter()
    for draw in range(runs):
        noisy = add_noise(ideal, np.random.default_rng([31, draw]))
        cases = {"clean": noisy}
        for label in ("both sides", "one side"):
            cases[label] = _spoiled(noisy, np.random.default_rng([32, draw]), both_sides=label == "both sides")
        for label, case in cases.items():
            result = calibrate_observations(exact_rig.observations(case, config), settings=exact_rig.SETTINGS)
            turned = exact_rig.to_true_tangents(result.scanner, config)
            error = turned @ exact_rig.errors(result.scanner, config)
            found[label].append((error, np.sqrt(np.diag(turned @ result.covariance @ turned.T))))
        progress(f"{draw + 1} of {runs} draws, {time.perf_counter() - started:.0f} s")
    clean, clean_sigma = (np.array(part) for part in zip(*found["clean"], strict=True))
    free = clean_sigma[0] > 0
    figures = []
    for label in ("both sides", "one side"):
        error, sigma = (np.array(part) for part in zip(*found[label], strict=True))
        with np.errstate(invalid="ignore"):
            predicted = sigma.mean(0) / clean_sigma.mean(0)
            sample = error.std(0) / clean.std(0)
            # Of the same noise: little of it is left in the difference.
            bias = np.abs((error - clean).mean(0)) / clean_sigma.mean(0)
        # Ratios of two standard deviations from 6 paired draws scatter by a fifth.
        most = 2.0 if quick else 1.3
        for title, values, bound, unit in (
            ("predicted over clean", predicted, 1.3, ""),
            ("sample over clean", sample, most, ""),
            ("bias", bias, 0.5, "sigma"),
        ):
            worst = np.flatnonzero(free)[np.argmax(values[free])]
            key = f"{label}: {title}, worst ({names[worst]})"
            figures.append(Figure(key, float(values[worst]), unit, high=bound))
    return figures


def _spoiled(noisy: IdealBoards, random: np.random.Generator, *, both_sides: bool) -> IdealBoards:
    """The same with gross errors: of corners in any direction, of stripe points across the stripe, to both sides or,
    like reflections, all to one side."""

    def size(count: int) -> np.ndarray:
        return np.exp(random.uniform(*np.log(WRONG_PX), size=count))

    corner_q, stripe_q = noisy.corner_q.copy(), noisy.stripe_q.copy()
    wrong = random.random(corner_q.shape[:2]) < WRONG_CORNERS
    way = random.uniform(0, 2 * np.pi, size=wrong.sum())
    corner_q[wrong] += size(wrong.sum())[:, None] * np.stack([np.cos(way), np.sin(way)], -1)
    wrong = (random.random(stripe_q.shape[:2]) < WRONG_STRIPES) & noisy.stripe_valid
    side = random.choice([-1.0, 1.0], size=wrong.sum()) if both_sides else 1.0
    stripe_q[wrong, 0] += side * size(wrong.sum())
    return noisy._replace(corner_q=corner_q, stripe_q=stripe_q)


EXPERIMENTS = {"honesty": (honesty, 200, 12), "joint": (joint, 60, 3), "outliers": (outliers, 40, 6)}
"""Each with its number of runs, and that of the quick form."""


def main() -> int:
    """The command."""
    parser = command_line(__doc__, quick="few runs: shows that all of it works, not how exact it is", json=True)
    parser.add_argument("name", choices=EXPERIMENTS)
    parser.add_argument("--runs", type=int, help="calibrations, or draws of noise of each set of poses")
    options = parser.parse_args()
    run, usual, quick = EXPERIMENTS[options.name]
    figures = run(options.runs or (quick if options.quick else usual), options.quick)
    return conclude(f"calibration-{options.name}", figures, options.json)


if __name__ == "__main__":
    sys.exit(main())
