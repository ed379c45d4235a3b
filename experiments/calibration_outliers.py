"""Gross errors in a calibration: 3 % of the corners and 10 % of the stripe points are wrong.

Each draw is calibrated with and without the outliers. They are 3 to 50 px large: in any direction
for corners, across the stripe for stripe points, either to both sides or, like reflections, all to
one side.

    python experiments/calibration_outliers.py [--draws 40] [--quick] [--json FILE]
"""

import sys
import time

import numpy as np
from report import Figure, command_line, conclude, progress
from worlds import exact_rig
from worlds.exact_rig import IdealBoards, PosePlan, add_noise, draw_poses, ideal_boards

from jaxscan.calibration import calibrate_observations
from jaxscan.simulation import true_scanner


CORNERS, STRIPES = 0.03, 0.10
SIZE_PX = (3.0, 50.0)
POSE_SEED = 7


def spoiled(noisy: IdealBoards, random: np.random.Generator, *, both_sides: bool) -> IdealBoards:
    """The same observations with gross errors."""

    def size(count: int) -> np.ndarray:
        return np.exp(random.uniform(*np.log(SIZE_PX), size=count))

    corner_q, stripe_q = noisy.corner_q.copy(), noisy.stripe_q.copy()
    wrong = random.random(corner_q.shape[:2]) < CORNERS
    way = random.uniform(0, 2 * np.pi, size=wrong.sum())
    corner_q[wrong] += size(wrong.sum())[:, None] * np.stack([np.cos(way), np.sin(way)], -1)
    wrong = (random.random(stripe_q.shape[:2]) < STRIPES) & noisy.stripe_valid
    side = random.choice([-1.0, 1.0], size=wrong.sum()) if both_sides else 1.0
    stripe_q[wrong, 0] += side * size(wrong.sum())
    return noisy._replace(corner_q=corner_q, stripe_q=stripe_q)


def main() -> int:
    parser = command_line(__doc__, quick="few draws: shows that all runs, not how exact it is", json=True)
    parser.add_argument("--draws", type=int, default=40)
    arguments = parser.parse_args()
    draws = 6 if arguments.quick else arguments.draws
    config = exact_rig.reference()
    ideal = ideal_boards(config, draw_poses(config, POSE_SEED, PosePlan(free_views=30, placements=4, angles=9)))
    names = true_scanner(config).parameter_names()
    found: dict[str, list] = {"clean": [], "both sides": [], "one side": []}
    started = time.perf_counter()
    for draw in range(draws):
        noisy = add_noise(ideal, np.random.default_rng([31, draw]))
        cases = {"clean": noisy}
        for label in ("both sides", "one side"):
            cases[label] = spoiled(noisy, np.random.default_rng([32, draw]), both_sides=label == "both sides")
        for label, case in cases.items():
            result = calibrate_observations(exact_rig.observations(case, config), settings=exact_rig.SETTINGS)
            turned = exact_rig.to_true_tangents(result.scanner, config)
            error = turned @ exact_rig.errors(result.scanner, config)
            found[label].append((error, np.sqrt(np.diag(turned @ result.covariance @ turned.T))))
        progress(f"{draw + 1} of {draws} draws, {time.perf_counter() - started:.0f} s")
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
        most = 2.0 if arguments.quick else 1.3
        for title, values, bound, unit in (
            ("predicted over clean", predicted, 1.3, ""),
            ("sample over clean", sample, most, ""),
            ("bias", bias, 0.5, "sigma"),
        ):
            worst = np.flatnonzero(free)[np.argmax(values[free])]
            key = f"{label}: {title}, worst ({names[worst]})"
            figures.append(Figure(key, float(values[worst]), unit, high=bound))
    return conclude("calibration-outliers", figures, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
