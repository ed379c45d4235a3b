"""Accuracy of wall distances in a room, from board images to calibration, frames to cloud, over several seeds.

Every seed draws its own board poses and all of its noise. The room without noise is rendered
once and exposed once per seed. Only the comparison at the end uses the truth.

    python experiments/room_accuracy.py [configs/paper.toml] [--every 10] [--seeds 5] [--json FILE]

With --quick the demo's rig is taken, at few steps and with one seed, to see that it works.
"""

import argparse
import itertools
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import jaxscan
from jaxscan.geometry import Scanner
from jaxscan.simulation import ExpectedRecord, PlanSpec, SimulationConfig, develop, expect_sweep


CHUNK = 24
"""Records that are rendered together and held in memory."""
QUICK_CONFIG = Path(jaxscan.__file__).parent / "data" / "demo.toml"
AMPLITUDE_SIGMAS = 5.0
"""A stripe counts as visible from this many standard deviations of a difference pixel on."""


def calibrated(config: SimulationConfig, seed: int, folder: Path) -> Scanner:
    """A scanner from rendered board images alone, through files as a user would."""
    boards_only = config.model_copy(update={"plan": PlanSpec(steps=1)})
    made = jaxscan.simulate(boards_only, folder, seed=seed)
    result = jaxscan.calibrate(jaxscan.open_capture(made.boards))
    jaxscan.save_calibration(result, folder / "calibration.json")
    quality = result.quality
    print(
        f"seed {seed}: {quality.views} boards, corners {quality.corner_rms_px:.4f} px, "
        f"{quality.stripe_points} stripe points, whitened {quality.stripe_rms_whitened:.3f}",
        file=sys.stderr,
    )
    return jaxscan.load_scanner(folder / "calibration.json")


def reconstructed(config: SimulationConfig, records: list[ExpectedRecord], seed: int, scanner: Scanner) -> tuple:
    """One chunk's cloud, and which of its visible rows have a point: cloud, visible, found."""
    frames = [develop(record, config, np.random.default_rng([seed, round(1e6 * record.angle)])) for record in records]
    on, off = (np.stack([getattr(frame, name) for frame in frames]) for name in ("on", "off"))
    angle = np.array([record.angle for record in records])
    sweep = jaxscan.Sweep(on, off, angle, pixel_format=config.sensor.pixel_format)
    cloud = jaxscan.reconstruct(sweep, scanner)
    visible = np.stack([is_visible(record, config) for record in records])
    return cloud, int(visible.sum()), int((visible & cloud.valid).sum())


def is_visible(record: ExpectedRecord, config: SimulationConfig) -> np.ndarray:
    """Rows whose true stripe stands out of the noise of the difference."""
    rows = np.arange(len(record.truth.u))
    column = np.clip(np.rint(record.truth.u).astype(int), 0, record.off.shape[1] - 1)
    ambient = record.off[rows, column].reshape(len(rows), -1)[:, 0]
    sensor = config.sensor
    variance = 2 * sensor.read_dn**2 + 2 * ambient / sensor.electrons_per_dn + 2 / 12
    return record.truth.valid & (record.truth.amplitude >= AMPLITUDE_SIGMAS * np.sqrt(variance))


def joined(parts: list[jaxscan.PointCloud]) -> jaxscan.PointCloud:
    """Clouds of consecutive chunks as one."""
    there = [name for name, field in vars(parts[0]).items() if field is not None]
    return jaxscan.PointCloud(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in there})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", nargs="?", type=Path, default=Path("configs/paper.toml"))
    parser.add_argument("--every", type=int, default=10, help="every n-th step of the sweep")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep board captures, calibrations and clouds here")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file (- for standard output)")
    parser.add_argument("--quick", action="store_true", help="the demo's rig, few steps, one seed")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.config, arguments.every, arguments.seeds = QUICK_CONFIG, 2, 1
    config = jaxscan.load_simulation(arguments.config)
    if config.room is None:
        parser.error("the configuration has no [room]")
    seeds = range(1, arguments.seeds + 1)
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        kept = arguments.keep or Path(folder)
        scanners = {seed: calibrated(config, seed, kept / str(seed)) for seed in seeds}
    parts: dict[int, list] = {seed: [] for seed in seeds}
    visible, found = dict.fromkeys(seeds, 0), dict.fromkeys(seeds, 0)
    records = expect_sweep(config, every=arguments.every)
    while chunk := list(itertools.islice(records, CHUNK)):
        for seed in seeds:
            cloud, could, did = reconstructed(config, chunk, seed, scanners[seed])
            parts[seed].append(cloud)
            visible[seed] += could
            found[seed] += did
    width, length = sorted(config.room.size_m[:2])
    truth = {"length": length, "width": width, "height": config.room.size_m[2]}
    rows = []
    for seed in seeds:
        cloud = joined(parts[seed])
        if arguments.keep:
            jaxscan.save_cloud(cloud, arguments.keep / str(seed) / "room.npz")
        box = jaxscan.measure_room(cloud, scanner=scanners[seed])
        for name, true in truth.items():
            side = getattr(box, name)
            if side is not None:
                error, sigma = side.value_m - true, side.sigma_m
                rows.append({"seed": seed, "side": name, "error_m": error, "sigma_m": sigma})
                print(f"seed {seed} {name:>7}: {1e3 * error:+7.3f} mm = {error / sigma:+.2f} predicted sigmas")
        print(f"seed {seed}: {100 * found[seed] / visible[seed]:.2f} % of {visible[seed]} visible rows have a point")
    metrics = []
    for name in truth:
        errors = np.array([row["error_m"] for row in rows if row["side"] == name])
        if len(errors):
            ratio = max(abs(row["error_m"] / row["sigma_m"]) for row in rows if row["side"] == name)
            metrics.append({"key": f"{name}_rms", "value": 1e3 * float(np.sqrt(np.mean(errors**2))), "unit": "mm"})
            metrics.append({"key": f"{name}_worst", "value": float(ratio), "unit": "predicted sigmas"})
    completeness = min(found[seed] / visible[seed] for seed in seeds)
    metrics.append({"key": "visible_rows_with_point", "value": 100 * completeness, "unit": "%, worst seed"})
    for metric in metrics:
        print(f"{metric['key']:>24} {metric['value']:9.3f} {metric['unit']}")
    print(f"{time.perf_counter() - started:.0f} s", file=sys.stderr)
    if arguments.json:
        text = json.dumps({"format": "jaxscan-room-accuracy/1", "rows": rows, "metrics": metrics}, indent=2) + "\n"
        sys.stdout.write(text) if arguments.json == "-" else Path(arguments.json).write_text(text)


if __name__ == "__main__":
    main()
