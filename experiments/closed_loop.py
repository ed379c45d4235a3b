"""A whole scan without hardware: boards and a sweep through host, serial line, firmware, trigger wire and GigE camera.

The rig is calibrated from the boards alone, and the walls of the cloud are compared with the truth.

The firmware runs in a simulated processor, and the camera serves rendered pictures on loopback
(hardware/bench). The host is driven by the command line. The truth (the view of each frame, and
the walls) is read only for the comparison at the end.

    python -m experiments.closed_loop [--two-lasers] [--json FILE] [--keep DIR]

Needs `make bench-deps`.
"""

import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from bench.desk import Desk, set_up
from bench.places import TWO_LASERS, WORLD

import jaxscan
from experiments.report import ROOT, Figure, command_line, conclude, rms, verb
from jaxscan.simulation import SimulationConfig, expect_sweep, true_cloud, truth


CONFIG, CONFIG_TWO = (ROOT / "configs" / name for name in ("bench.toml", "bench_two_lasers.toml"))
ON_PLANE_M = 1e-3
"""Distance at which a true point lies on a plane of the room."""


def jaxscan_verb(*words: str) -> dict[str, Any]:
    """The JSON of one verb, run as a user does."""
    with tempfile.NamedTemporaryFile(suffix=".json") as answer:
        done = verb(*words, "--json", answer.name)
        if done.code:
            raise SystemExit(f"{' '.join(words)}: exit code {done.code}: {done.out[-2000:]}{done.problem[-2000:]}")
        return dict(json.loads(Path(answer.name).read_text()))


def shots_right(capture: Path, ledger: Path, microsteps_per_turn: int) -> tuple[int, int]:
    """Number of records, and of those that agree with the camera's own ledger.

    A record is right if both of its frames were rendered at the microstep that it names, the first
    in the light of its laser alone and the second without any.
    """
    sent = [entry for entry in map(json.loads, ledger.read_text().splitlines()) if entry["sent"]]
    records = {}
    for line in map(json.loads, (capture / "frames.jsonl").read_text().splitlines()):
        if "i" in line:
            records[line["i"]] = line
    # Frames are matched by position in the order of their numbers: one constant offset for the whole capture.
    first = min(min(record["frame_ids"]) for record in records.values())
    right = 0
    for record in records.values():
        on, off = (sent[number - first] for number in record["frame_ids"])
        angle = 360.0 * record["microsteps"] / microsteps_per_turn
        right += (
            on["position"] == off["position"] == record["microsteps"]
            and [on["light"], on["light_2"]] == ([0.0, 1.0] if record.get("lasers") == ["right"] else [1.0, 0.0])
            and off["light"] == off["light_2"] == 0.0
            and abs(record["angle_deg"] - angle) < 1e-9
        )
    return len(records), right


def wall_errors(cloud: jaxscan.PointCloud, world: SimulationConfig) -> list[dict[str, Any]]:
    """Signed distances of points from the plane of the room that they truly lie on, towards the inside [m].

    Which surface each cell of the grid sees is the truth's word; a cell whose point was found on another surface counts
    with its whole error.
    """
    xyz, true_xyz = np.asarray(cloud.xyz, np.float64), true_cloud(expect_sweep(world))
    rows = []
    for plane in truth(world)["room"]["planes"]:
        normal, distance = np.array(plane["normal"]), plane["distance_m"]
        seen = true_xyz[1] & (np.abs(true_xyz[0] @ normal - distance) < ON_PLANE_M)
        found = seen & np.asarray(cloud.valid)
        errors = xyz[found] @ normal - distance
        if not len(errors):
            continue
        rows.append(
            {
                "name": plane["name"],
                "cells": int(seen.sum()),
                "points": len(errors),
                "median_m": float(np.median(errors)),
                "rms_m": rms(errors),
                "p95_m": float(np.quantile(np.abs(errors), 0.95)),
                "beyond_20_mm": float((np.abs(errors) > 0.02).mean()),
            }
        )
    return rows


def calibrated(desk: Desk, config: Path, folder: Path) -> Path:
    """A calibration from boards that were shown to the loop."""
    place = f"{sys.executable} -m bench place"
    how = ("--boards", "--place-command", place, "--port", desk.rig.port)
    boards = jaxscan_verb("scan", str(config), "-o", str(folder / "boards"), *how)
    desk.command("place none")
    print(f"boards: {boards['records']} pairs, {boards['retakes']} retakes", file=sys.stderr)
    path = folder / "calibration.json"
    jaxscan_verb("calibrate", str(folder / "boards"), "-o", str(path))
    return path


def main() -> int:
    parser = command_line(__doc__, json=True)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep captures, calibration and cloud here")
    parser.add_argument("--two-lasers", action="store_true", help="a rig with a second laser, and fewer steps")
    arguments = parser.parse_args()
    config, place = (CONFIG_TWO, TWO_LASERS) if arguments.two_lasers else (CONFIG, WORLD)
    with tempfile.TemporaryDirectory() as temporary:
        folder = (arguments.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["JAXSCAN_BENCH"] = str(Path(temporary) / "bench")
        seconds = {}
        with set_up(Path(temporary) / "bench", world=place, wait_s=600.0) as desk:
            start = time.perf_counter()
            calibration = calibrated(desk, config, folder)
            seconds["boards and calibration"] = time.perf_counter() - start
            ledger = desk.camera.ledger
            before = ledger.stat().st_size
            start = time.perf_counter()
            live = folder / "live.npz"
            sweep = folder / "sweep"
            how = ("--port", desk.rig.port, "-c", str(calibration), "--cloud", str(live))
            scan = jaxscan_verb("scan", str(config), "-o", str(sweep), *how)
            seconds["sweep with live cloud"] = time.perf_counter() - start
            mine = folder / "sweep-truth.jsonl"
            mine.write_bytes(ledger.read_bytes()[before:])
        start = time.perf_counter()
        jaxscan_verb("reconstruct", str(sweep), "-c", str(calibration), "-o", str(folder / "room.npz"), "--no-cache")
        seconds["reconstruct"] = time.perf_counter() - start
        records, right = shots_right(sweep, mine, 28800)
        world = jaxscan.load_simulation(place)
        clouds = {name: jaxscan.load_cloud(path) for name, path in (("room", folder / "room.npz"), ("live", live))}
        rows = wall_errors(clouds["room"], world)
        both = np.asarray(clouds["room"].valid) & np.asarray(clouds["live"].valid)
        apart = np.abs(np.asarray(clouds["room"].xyz) - np.asarray(clouds["live"].xyz))[both]
        differing = int((np.asarray(clouds["room"].valid) != np.asarray(clouds["live"].valid)).sum())
        box = jaxscan.measure_room(clouds["room"], scanner=jaxscan.load_scanner(calibration))
    width, length = sorted(world.room.size_m[:2]) if world.room is not None else (0.0, 0.0)
    sides = {name: (getattr(box, name), true) for name, true in (("length", length), ("width", width))}
    figures = [
        Figure("shots_right", 100.0 * right / records, "%", low=100.0),
        Figure("planes", len(rows), "of the room's 6"),
        Figure("worst_wall", 1e3 * max(abs(row["median_m"]) for row in rows), "mm", high=5.0),
        Figure("worst_wall_p95", 1e3 * max(row["p95_m"] for row in rows), "mm"),
        Figure("retakes", scan["retakes"], "pairs"),
        Figure("live_cloud_apart", 1e3 * float(apart.max()), "mm from the one of `reconstruct`"),
        Figure("live_cloud_differs", differing, "cells of which only one cloud has a point"),
        *(Figure(f"{name}_error", 1e3 * (side.value_m - true), "mm") for name, (side, true) in sides.items()),
        *(Figure(f"{name}_sigma", 1e3 * side.sigma_m, "mm") for name, (side, _) in sides.items()),
        *(Figure(name, value, "s") for name, value in seconds.items()),
    ]
    return conclude("closed-loop", figures, arguments.json, walls=rows)


if __name__ == "__main__":
    sys.exit(main())
