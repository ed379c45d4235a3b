"""Time and memory of the joint solve against optimistix' own solvers, and of the camera alone against OpenCV.

The joint problem has 40 views of 88 corners and 40 stripes of 1000 points, about 47 000 residuals,
with the default free parameters. All solvers minimise the same function from the same start, which
is off by tens of pixels, and stop at the same tolerance. Each runs in a separate process, so that
its peak memory can be measured. Times exclude compilation; only their ratios mean much.
"""

import json
import pickle
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from measuring.speed_calibration import camera_contest
from measuring.speed_times import take_turns
from worlds import calibration_trials as trials
from worlds.ideal_boards import PosePlan, add_noise, draw_poses, ideal_boards

from jaxscan.calibration import CalibrationSettings, calibrate_observations
from jaxscan.calibration.first_values import average_placements
from jaxscan.calibration.joint import priors, solve
from jaxscan.calibration.problem import Problem, camera_from_board, make_problem, move, prepare, zero_step
from jaxscan.calibration.rows import corner_rows, stripe_rows
from jaxscan.geometry import Array, invert
from jaxscan.leastsq import Unknowns


TOLERANCE, MAX_STEPS, DAMPING = 1e-8, 60, 1e-4
VIEWS, POINTS = 40, 1000
# How far the start is off, in scaled units: 3 px of focal length, 0.3 mm and 0.3 mrad of the rig ...,
# and 5 mm and 5 mrad of every board, which is tens of pixels.
SHARED_OFF, LOCAL_OFF = 0.03, 0.5
MAX_RSS_GB = 1.5
OURS, DEFAULT, NORMAL = "ours", "optimistix LM, default", "optimistix LM, Normal(Cholesky)"


def joint_problem() -> Problem:
    """The problem with its weights, without padding, at a start that is off."""
    config = trials.reference()
    poses = draw_poses(config, 3, PosePlan(free_views=VIEWS - 9, placements=3, angles=3))
    noisy = add_noise(ideal_boards(config, poses, points=POINTS), np.random.default_rng(0))
    observed = trials.observations(noisy, config)
    settings = CalibrationSettings(judge=False)
    found = calibrate_observations(observed, settings=settings)
    scanner, fit, data = found.scanner, found.fit, prepare(observed)
    views = np.tile(np.eye(4), (len(data.usable), 1, 1))
    views[: len(fit.pose)] = fit.pose
    boards = average_placements(views, data, scanner.turntable)
    problem = make_problem(scanner.camera, scanner.lasers, scanner.turntable, boards, data, settings)
    # Padding would be additional work for the other solvers.
    shapes = {
        "poses": (int(data.placement.max()) + 1,),
        "board": (observed.corners.q.shape[1],),
        **dict.fromkeys(("corner_q", "corner_weight"), observed.corners.q.shape[:2]),
        **dict.fromkeys(("angle", "placement", "seen"), (VIEWS,)),
        **dict.fromkeys(("stripe_q", "stripe_weight"), observed.stripes.q.shape[:2]),
        **dict.fromkeys(("stripe_view", "stripe_laser", "lit"), observed.stripes.q.shape[:1]),
    }
    for name, shape in shapes.items():
        cut = getattr(problem, name)[tuple(slice(0, n) for n in shape)]
        problem = eqx.tree_at(lambda p, name=name: getattr(p, name), problem, cut)
    problem = eqx.tree_at(lambda p: p.modes.corner, problem, problem.modes.corner[: observed.corners.q.shape[1]])
    corner = observed.corners.valid / trials.CORNER_PX
    # About the width of one pixel across the stripe [m]; the weights need only be the same for all.
    stripe = observed.stripes.valid / (trials.STRIPE_PX * 1.5e-3)
    problem = eqx.tree_at(lambda p: (p.corner_weight, p.stripe_weight), problem, (corner, stripe))
    random, step = np.random.default_rng(1), zero_step(problem)
    off = Unknowns(SHARED_OFF * random.normal(size=step.shared.shape), LOCAL_OFF * random.normal(size=step.local.shape))
    return move(jax.tree.map(jnp.asarray, off), jax.tree.map(jnp.asarray, problem))


def residuals(step: Unknowns, problem: Problem) -> tuple[Array, Array, Array]:
    """Whitened residuals of corners, stripes and priors as any solver may differentiate them by a step.

    As in the solve, derivatives are formed once per point, by the few departures of its view.
    """
    moved = move(step, problem)
    fixed = jax.lax.stop_gradient(moved)
    corners, (stripes, _) = corner_rows(fixed), stripe_rows(fixed)
    turn = jnp.matmul(jax.vmap(invert)(camera_from_board(fixed)), camera_from_board(moved))
    twist = jnp.stack([turn[:, 0, 3], turn[:, 1, 3], turn[:, 2, 3], turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], 1)
    twist = twist - jax.lax.stop_gradient(twist)
    camera, board = moved.camera.parameters() - fixed.camera.parameters(), moved.shape - fixed.shape
    numbers = lambda p: jnp.concatenate([p.lasers.normal, p.lasers.distance[:, None], p.lasers.bow], axis=1)
    sheet = (numbers(moved) - numbers(fixed))[problem.stripe_laser]
    spread = lambda values, like: jnp.broadcast_to(values, (len(like), len(values)))
    corner = jnp.concatenate([spread(camera, twist), twist, spread(board, twist)], axis=1)
    stripe = twist[problem.stripe_view]
    stripe = jnp.concatenate([spread(camera, sheet), stripe, spread(board[:2], sheet), sheet], axis=1)
    linear = lambda rows, away: rows.value + jnp.einsum("ord,od->or", rows.slopes, away)
    weight = jnp.repeat(problem.corner_weight, 2, axis=1)
    return linear(corners, corner) * weight, linear(stripes, stripe) * problem.stripe_weight, priors(moved)


@eqx.filter_jit
def by_optimistix(problem: Problem, linear: lx.AbstractLinearSolver) -> tuple[Problem, Any, Any]:
    """Levenberg-Marquardt as optimistix has it."""
    solver = optx.LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE, norm=optx.rms_norm, linear_solver=linear)
    found = optx.least_squares(residuals, solver, zero_step(problem), args=problem, max_steps=MAX_STEPS, throw=False)
    return move(found.value, problem), found.stats["num_steps"], found.result == optx.RESULTS.successful


def by_block_arrow(problem: Problem) -> tuple[Problem, Any, Any]:
    """Ours: optimistix' loop and trust region, with the step of a block arrow."""
    found = solve(problem, DAMPING, TOLERANCE, MAX_STEPS)
    return found.problem, found.steps, found.converged


def step_to(end: Problem, problem: Problem) -> Unknowns:
    """The one step from the start to an end that many steps may have led to; directions do not simply add."""
    flat, shaped = ravel_pytree(zero_step(problem))
    parts = lambda p: ravel_pytree((p.camera, p.lasers, p.turntable, p.poses, p.shape))[0]
    left = jax.jit(lambda step: parts(move(shaped(step), problem)) - parts(end))
    slopes = jax.jit(jax.jacfwd(left))
    for _ in range(6):
        matrix = np.asarray(slopes(flat))
        size = np.maximum(np.linalg.norm(matrix, axis=0), np.finfo(float).tiny)
        flat = flat - np.linalg.lstsq(matrix / size, np.asarray(left(flat)))[0] / size
    return shaped(flat)


def peak_gb() -> float:
    """Peak resident memory of this process; `getrusage` would count that of the parent before it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 2**20 for line in lines if line.startswith("VmHWM"))


def joint(solver: str, file: str, repeats: int) -> dict[str, Any]:
    """One solver in this process, on the problem that the parent wrote."""
    with jax.enable_x64(True):
        # Own file, own process: only this script writes and reads it.
        problem = jax.tree.map(jnp.asarray, pickle.loads(Path(file).read_bytes()))
        before = peak_gb()
        run = {
            OURS: by_block_arrow,
            DEFAULT: lambda p: by_optimistix(p, lx.QR()),
            NORMAL: lambda p: by_optimistix(p, lx.Normal(lx.Cholesky())),
        }[solver]
        started = time.perf_counter()
        jax.block_until_ready(run(problem))
        first, times = time.perf_counter() - started, []
        for _ in range(repeats):
            started = time.perf_counter()
            end, steps, converged = jax.block_until_ready(run(problem))
            times.append(time.perf_counter() - started)
        step = step_to(end, problem)
        left = residuals(step, problem)
        start = residuals(zero_step(problem), problem)
        error = np.asarray(start[0]) / trials.CORNER_PX**-1
        return {
            "seconds": min(times),
            "first_s": first,
            "steps": int(steps),
            "converged": bool(converged),
            "cost": float(sum(jnp.sum(part**2) for part in left)),
            "shared": np.asarray(step.shared).tolist(),
            "residuals": int(sum(part.size for part in left)),
            "unknowns": int(step.shared.size + step.local.size),
            "start_px": float(np.sqrt(np.mean(error**2))),
            "rss_gb": peak_gb(),
            "rss_before_gb": before,
        }


def camera(repeats: int) -> dict[str, Any]:
    """Whole camera calibrations, seed and covariance and rejection included, beside OpenCV's."""
    ours, theirs = camera_contest()
    times = take_turns({"ours": ours, "opencv": theirs}, repeats)
    found, (rms, matrix, *_) = ours(), theirs()
    return {
        "ours_s": times["ours"].best,
        "opencv_s": times["opencv"].best,
        "ours_fx": float(found.camera.fx),
        "opencv_fx": float(matrix[0, 0]),
        "opencv_rms": rms,
    }


def main() -> int:
    parser = trials.parser(__doc__)
    parser.add_argument("--only", help="one of the solvers, or camera, in this process, as JSON")
    parser.add_argument("--problem", help="file of the problem, for --only")
    arguments = parser.parse_args()
    repeats = 1 if arguments.quick else 5
    if arguments.only:
        result = (
            camera(2 * repeats) if arguments.only == "camera" else joint(arguments.only, arguments.problem, repeats)
        )
        print(json.dumps(result))
        return 0
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "problem.pickle"
        with jax.enable_x64(True):
            file.write_bytes(pickle.dumps(jax.tree.map(np.asarray, joint_problem())))
        for name in (OURS, DEFAULT, NORMAL, "camera"):
            quick = ["--quick"] if arguments.quick or name in (DEFAULT, NORMAL) else []
            command = [sys.executable, __file__, "--only", name, "--problem", str(file), *quick]
            found[name] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
            shown = ", ".join(f"{key} {value:.4g}" for key, value in found[name].items() if key != "shared")
            trials.progress(f"{name}: {shown}")
    ours, default, normal, lens = (found[name] for name in (OURS, DEFAULT, NORMAL, "camera"))
    apart = np.abs(np.subtract(ours["shared"], default["shared"])).max() / np.abs(default["shared"]).max()
    figures = [
        trials.Figure("residuals", ours["residuals"], ""),
        trials.Figure("unknowns", ours["unknowns"], ""),
        trials.Figure("ours", ours["seconds"], "s"),
        trials.Figure("optimistix LM, default", default["seconds"], "s"),
        trials.Figure("optimistix LM, Normal(Cholesky)", normal["seconds"], "s"),
        trials.Figure("ours over default", ours["seconds"] / default["seconds"], "", high=0.1),
        trials.Figure("ours over Normal(Cholesky)", ours["seconds"] / normal["seconds"], ""),
        trials.Figure("peak memory of the process, ours", ours["rss_gb"], "GB", high=MAX_RSS_GB),
        trials.Figure("peak memory of the process, default", default["rss_gb"], "GB"),
        trials.Figure("same minimum as the default's QR, scaled unknowns", apart, "relative", high=1e-9),
        trials.Figure("camera alone over OpenCV", lens["ours_s"] / lens["opencv_s"], "", high=1.0),
    ]
    return trials.report("solver-time", figures, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
