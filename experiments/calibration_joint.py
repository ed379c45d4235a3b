"""Depth error of the laser plane at 2.5 m: one joint solve against the usual sequence, on the same data.

The usual sequence solves the camera from board corners alone, lifts the stripe points to their
boards, and fits a plane: by total least squares and as a X + b Y + Z = c, of which the better one
counts. Its camera and board poses come from our solve without stripes, with the same priors and the
board's bow, so that only the sequence differs. Two views of each set show one board before and
after a turn by 10 degrees, which the joint solve of the whole rig needs.

Every pose set and every draw of noise counts alike. The depth error of a draw is the root mean
square over all rows of the image of the depth found at the pixel where the true depth is 2.5 m.

    python experiments/calibration_joint.py [--sets 5] [--draws 60] [--case '4 of 23'] [--quick] [--json FILE]
"""

import sys
import time
from typing import NamedTuple

import numpy as np
from report import Figure, command_line, conclude, progress
from worlds import exact_rig
from worlds.exact_rig import BoardPoses, PosePlan, add_noise, draw_poses, ideal_boards

from jaxscan.calibration import (
    Calibration,
    calibrate_camera,
    calibrate_observations,
    depth_sigma,
    stripe_depths,
    stripe_pixels,
)
from jaxscan.geometry import LaserSheet, Scanner, Turntable, stack_lasers
from jaxscan.observation import Observations
from jaxscan.simulation import SimulationConfig, true_scanner


DEPTH_M = 2.5
CASES = {"4 of 23": (23, 4, 0.85), "30 of 30": (30, 30, 0.65)}
"""Views, views with a stripe, and the most that the joint error may be of the sequential one."""


class Errors(NamedTuple):
    """Depth errors of one draw [m]."""

    joint: float
    predicted: float
    total: float
    """Sequential, by total least squares."""
    linear: float
    """Sequential, by a X + b Y + Z = c."""


def poses_of(config: SimulationConfig, views: int, stripes: int, seed: int) -> BoardPoses:
    """So many views, the last two of them one board that was turned."""
    free = views - 2
    poses = draw_poses(
        config, seed, PosePlan(free_views=free, placements=1, angles=2, span_deg=10.0, lit=min(stripes, free))
    )
    return poses if stripes > free else poses._replace(lit=poses.lit & (poses.placement < free))


def sequential(observed: Observations, result: Calibration) -> tuple[LaserSheet, LaserSheet]:
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
    middle = p.mean(0)
    normal = np.linalg.svd(p - middle, full_matrices=False)[2][2]
    a, b, c = np.linalg.lstsq(np.column_stack([p[:, :2], -np.ones(len(p))]), -p[:, 2], rcond=None)[0]
    return LaserSheet.from_plane(normal, normal @ middle), LaserSheet.from_abc(a, b, c)


def depth_error(scanner: Scanner, q: np.ndarray) -> float:
    """Root mean square over rows [m]."""
    return float(np.sqrt(np.mean((stripe_depths(scanner, 0, q) - DEPTH_M) ** 2)))


def trial(observed: Observations, alone: Calibration, q: np.ndarray) -> Errors:
    """One draw of noise, solved jointly and after the camera alone."""
    joint = calibrate_observations(observed, settings=exact_rig.SETTINGS).scanner
    planes = sequential(observed, alone)
    # A plane's depth has nothing to do with the table.
    table = Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.1])
    total, linear = (depth_error(Scanner(alone.camera, stack_lasers([sheet]), table), q) for sheet in planes)
    predicted = np.sqrt(np.mean(depth_sigma(joint, 0, q) ** 2))
    return Errors(depth_error(joint, q), float(predicted), total, linear)


def ratio_error(squares: np.ndarray) -> float:
    """Relative standard error of the root of a mean of squares.

    The errors of all rows of a draw hang together, so a draw counts as one observation.
    """
    return float(squares.std() / squares.mean() / np.sqrt(len(squares)) / 2)


def main() -> int:
    parser = command_line(__doc__, quick="few draws: shows that all runs, not how exact it is", json=True)
    parser.add_argument("--sets", type=int, default=5)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--case", choices=CASES, help="one of the two alone")
    arguments = parser.parse_args()
    sets, draws = (2, 3) if arguments.quick else (arguments.sets, arguments.draws)
    config = exact_rig.reference()
    q = stripe_pixels(true_scanner(config), 0, DEPTH_M)
    figures = []
    for name, (views, stripes, most) in CASES.items():
        if arguments.case not in (None, name):
            continue
        started, found = time.perf_counter(), {noise: [] for noise in exact_rig.CORRELATIONS}
        for number in range(sets):
            ideal = ideal_boards(config, poses_of(config, views, stripes, 100 + number))
            for draw in range(draws):
                alone = None
                for noise, correlation in exact_rig.CORRELATIONS.items():
                    # The same corners for both: stripes draw their noise after them.
                    noisy = add_noise(ideal, np.random.default_rng([number, draw]), correlation=correlation)
                    observed = exact_rig.observations(noisy, config)
                    alone = alone or calibrate_camera(observed, settings=exact_rig.SETTINGS)
                    found[noise].append(trial(observed, alone, q))
            progress(f"{name}: pose set {number + 1} of {sets}, {time.perf_counter() - started:.0f} s")
        for noise, every in found.items():
            errors = Errors(*np.array(every).T)
            best = min(errors.total.mean(), errors.linear.mean())
            label = f"{name}, {noise}"
            # Of two pose sets with three draws only so much can be said: joint is no worse.
            bounds = (0.3, 2.0) if arguments.quick else (0.85, 1.15)
            figures += [
                Figure(f"{label}: joint", 1e3 * errors.joint.mean(), "mm"),
                Figure(f"{label}: sequential, total least squares", 1e3 * errors.total.mean(), "mm"),
                Figure(f"{label}: sequential, linear", 1e3 * errors.linear.mean(), "mm"),
                Figure(
                    f"{label}: joint over sequential",
                    errors.joint.mean() / best,
                    "",
                    high=1.0 if arguments.quick else most,
                ),
                Figure(
                    f"{label}: joint over predicted (root mean square)",
                    np.sqrt(np.mean(errors.joint**2) / np.mean(errors.predicted**2)),
                    "",
                    *bounds,
                ),
                Figure(f"{label}: its standard error", ratio_error(errors.joint**2), ""),
            ]
    return conclude("calibration-joint", figures, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
