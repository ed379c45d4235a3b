"""Tests the verdict of a calibration: it must find no structure in good data, and find it where models fall short.

The rig is configs/reference.toml, with the sigmas of the detector. Clean data have white or
correlated stripe noise. The faults are a lens term that the model lacks, a bowed board with the
warp held at zero, and a table with once-per-turn errors with the harmonics held at zero.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
from report import Figure, command_line, conclude, progress
from worlds import exact_rig
from worlds.exact_rig import BoardPoses, PosePlan, add_noise, draw_poses, ideal_boards

from jaxscan.calibration import CalibrationSettings, calibrate_observations
from jaxscan.simulation import SimulationConfig


ECCENTRICITY_RAD = 5e-4
WARP_MM = 0.3
LENS_PX = 0.3
CLEAN_P, FAULT_P = 0.01, 1e-3
FREE_VIEWS, LIT_VIEWS, POOL = 30, 15, 200
CELLS = 6
AROUND_DEG = (0.0, 90.0, 180.0, 270.0)


def covering_poses(config: SimulationConfig, seed: int, around_deg: tuple[float, ...]) -> BoardPoses:
    """30 free views and 4 placements of 9 angles, of which the free views without stripe fill the image.

    As in the instructions for people, the board goes into every corner. From many random poses the
    one is taken, again and again, whose corners are where the fewest were.
    """
    poses = draw_poses(config, seed, PosePlan(free_views=LIT_VIEWS, placements=4, angles=9, around_deg=around_deg))
    pool = draw_poses(config, seed + 1000, PosePlan(free_views=POOL, placements=0, angles=1, lit=0))
    size = np.array([config.camera.width, config.camera.height])
    cell = np.clip((ideal_boards(config, pool).corner_q / size * CELLS).astype(int), 0, CELLS - 1)
    seen = np.stack([np.bincount(row, minlength=CELLS**2) for row in cell[..., 1] * CELLS + cell[..., 0]])
    total, chosen = np.ones(CELLS**2), []
    for _ in range(FREE_VIEWS - LIT_VIEWS):
        gain = (np.log(total + seen) - np.log(total)).sum(1)
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        total += seen[chosen[-1]]
    count = len(chosen)
    return BoardPoses(
        [pool.boards[pool.placement[i]] for i in chosen] + poses.boards,
        np.concatenate([np.arange(count), poses.placement + count]),
        np.concatenate([pool.angle[chosen], poses.angle]),
        np.concatenate([pool.lit[chosen], poses.lit]),
    )


def chance(
    config: SimulationConfig, seed: int, settings: CalibrationSettings, correlation: float, lens_px: float = 0.0
) -> tuple[float, str]:
    """The verdict's p on fresh poses and noise, and the test that is the least likely."""
    around = AROUND_DEG if any(config.turntable.harmonics) else (0.0,)
    poses = covering_poses(config, 100 + seed, around)
    ideal = ideal_boards(config, poses, lens_px=lens_px)
    noisy = add_noise(ideal, np.random.default_rng([23, seed]), correlation=correlation)
    verdict = calibrate_observations(exact_rig.observations(noisy, config), settings=settings).quality.verdict
    return verdict.p, min(verdict.tests, key=lambda test: test.p).name


def cases() -> dict[str, tuple[bool, Callable[[int], tuple[float, str]]]]:
    """Name of each case: whether it is clean, and a trial of it by seed."""
    config = exact_rig.reference()
    default = CalibrationSettings()
    held = lambda block: CalibrationSettings(free=tuple(name for name in default.free if name != block))
    update = lambda part, **values: config.model_copy(update={part: getattr(config, part).model_copy(update=values)})
    bowed = update("boards", warp_mm=(WARP_MM, 0.0))
    # s1 on a turn that starts anywhere is c1 as well.
    eccentric = [
        update("turntable", harmonics=(ECCENTRICITY_RAD * c, ECCENTRICITY_RAD * s, 0.0, 0.0))
        for c, s in ((1.0, 0.0), (0.0, 1.0), (0.6, -0.8))
    ]
    white, correlated = exact_rig.CORRELATIONS["white"], exact_rig.CORRELATIONS["correlated"]
    return {
        "clean, white": (True, lambda seed: chance(config, seed, default, white)),
        "clean, correlated": (True, lambda seed: chance(config, seed, default, correlated)),
        "lens term, 0.3 px": (False, lambda seed: chance(config, seed, default, white, LENS_PX)),
        "bow, 0.3 mm": (False, lambda seed: chance(bowed, seed, held("warp"), white)),
        "eccentricity, 0.5 mrad": (False, lambda seed: chance(eccentric[seed % 3], seed, held("harmonics"), white)),
    }


def main() -> int:
    parser = command_line(__doc__, quick="few draws: shows that all runs, not how exact it is", json=True)
    parser.add_argument("--runs", type=int, default=20)
    arguments = parser.parse_args()
    runs = 2 if arguments.quick else arguments.runs
    figures = []
    for name, (clean, trial) in cases().items():
        started = time.perf_counter()
        found = [trial(seed) for seed in range(runs)]
        values, named = [p for p, _ in found], [test for _, test in found]
        progress(
            f"{name}: {time.perf_counter() - started:.0f} s; p {min(values):.2g} ... {max(values):.2g}; "
            + ", ".join(f"{test} {named.count(test)}" for test in dict.fromkeys(named))
        )
        if clean:
            # Each run is refused with a chance of 1 %: of 20, two are refused once in 60 times.
            refused = sum(p <= CLEAN_P for p in values)
            figures.append(Figure(f"{name}: refused", refused, f"of {runs}", high=1 if runs >= 20 else 0))
        else:
            missed = sum(p >= FAULT_P for p in values)
            figures.append(Figure(f"{name}: not noticed", missed, f"of {runs}", high=0))
            figures.append(Figure(f"{name}: largest p", max(values), "", high=FAULT_P))
    return conclude("calibration-verdict", figures, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
