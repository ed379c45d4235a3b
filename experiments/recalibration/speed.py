"""Time and memory of recalibrating from one sweep of 3600 steps whose stripes are known.

    python -m experiments.recalibration.speed FOLDER [--steps 3600] [--lines 1]

The sweep is made once and kept in the folder. The recalibration runs in a process of its own, with its compilation: at
most 60 s, 3 GB. Imports are not counted.
"""

import argparse
import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments.recalibration.kinds import SWEEPS, load
from experiments.recalibration.trial import calibration_of, draw_truth
from experiments.recalibration.world import sweep_of
from experiments.report import command_line
from jaxscan.recalibration import SweepStripes


SEED = 201
MOST_S, MOST_MB = 60.0, 3000.0


def make(folder: Path, steps: int, lines: int) -> None:
    """Write the sweep and the calibration."""
    config = draw_truth(load("paper"), SEED)
    stripes = sweep_of(config, SEED, replace(SWEEPS["paper"], steps=steps, line_stride=lines))
    small = {name: np.asarray(stripes._asdict()[name], np.float32) for name in ("centre", "sigma", "shared_lines")}
    folder.mkdir(parents=True, exist_ok=True)
    # Own files of one run: nobody else's are read.
    (folder / "calibration.pickle").write_bytes(pickle.dumps(calibration_of(config, "paper-like", SEED)))
    parts = {name: getattr(stripes, name) for name in ("valid", "record", "laser", "angle")}
    np.savez(folder / "sweep.npz", **small, **parts)


def run(folder: Path) -> dict[str, float]:
    """One recalibration in this process."""
    import resource
    import time

    from jaxscan.recalibration import recalibrate

    stored = pickle.loads((folder / "calibration.pickle").read_bytes())
    with np.load(folder / "sweep.npz") as file:
        stripes = SweepStripes(name="3600 steps", stripe_axis="rows", **file)
    loaded = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    started, cpu = time.perf_counter(), time.process_time()
    result = recalibrate([stripes], stored)
    return {
        "seconds": time.perf_counter() - started,
        "cpu_seconds": time.process_time() - cpu,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "loaded_mb": loaded,
        "points": len(result.adjusted.observations.points.q),
        "updated": float(result.updated),
    }


def main() -> int:
    """The command."""
    parser = command_line(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=3600)
    parser.add_argument("--lines", type=int, default=1)
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.alone:
        print(json.dumps(run(options.folder)))
        return 0
    if not (options.folder / "sweep.npz").exists():
        make(options.folder, options.steps, options.lines)
    command = [sys.executable, "-m", "experiments.recalibration.speed", str(options.folder), "--alone"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    figures = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(figures))
    good = figures["seconds"] <= MOST_S and figures["peak_mb"] <= MOST_MB
    print("met" if good else "MISSED", f"({MOST_S:g} s, {MOST_MB:g} MB)")
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
