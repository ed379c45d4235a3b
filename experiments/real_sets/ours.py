"""Runs the command line of one version of jaxscan on a capture, and reads its files."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.real_sets.figures import BoardLine, Solved, board_figures
from experiments.real_sets.pictures import Pictures
from experiments.real_sets.plain.boards import Lens, grid
from experiments.real_sets.plain.stripes import Plane


LIMIT_S = 1800
"""A run that takes longer is ended."""
ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
HALVES = Path(__file__).parent / "halves.py"


class Version(NamedTuple):
    """One version of jaxscan: the folder of its sources."""

    folder: Path

    def run(self, *arguments: str) -> tuple[int, str, str, float]:
        """Exit code, standard output, standard error and seconds of a Python command of this version."""
        places = os.pathsep.join([str(self.folder), str(self.folder / "hardware")])
        environment = os.environ | {"PYTHONPATH": places, "COLUMNS": "200"}
        start = time.perf_counter()
        command = [sys.executable, *arguments]
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=LIMIT_S, cwd=self.folder
        )
        return done.returncode, done.stdout, done.stderr, time.perf_counter() - start

    def verb(self, *arguments: str) -> tuple[int, str, str, float]:
        """The same of a verb of the command line."""
        return self.run("-m", "jaxscan.cli.main", *arguments)


def calibrate(version: Version, capture: Path, output: Path, options: tuple[str, ...]) -> dict[str, Any]:
    """One run of `jaxscan calibrate`: the first sentence that its user reads, and figures if it wrote a calibration.

    Args:
        version: The code.
        capture: Its capture.
        output: Calibration file to write.
        options: Of the verb.
    """
    for old in output.parent.glob(f"{output.stem}.*"):
        old.unlink()
    summary = output.with_suffix(".summary")
    target = ("-o", str(output), "--json", str(summary))
    code, out, problem, seconds = version.verb("calibrate", str(capture), *target, *options)
    plan = [line for line in out.splitlines() if line.startswith("solving for ")]
    notes = [line.replace(str(capture), capture.name) for line in out.splitlines() if line.startswith("note: ")]
    ended = problem.strip().splitlines()
    told = json.loads(summary.read_text()) if summary.exists() else {}
    verdict = told.get("verdict", {})
    sentence = f"{verdict['headline']}. {verdict['explanation']}" if verdict else (ended or [""])[-1]
    found: dict[str, Any] = {
        "options": " ".join(options).replace(str(output.parent), "").replace("/", ""),
        "plan": plan[0] if plan else "",
        "exit_code": code,
        "seconds": seconds,
        "sentence": sentence.replace(str(capture), capture.name).replace(str(output), output.name),
        "notes": notes,
        "error": ended[-1].replace(str(output), output.name).replace(str(capture), capture.name) if ended else "",
    }
    if not output.exists():
        return found
    quality = told.get("quality", {})
    kept = ("corner_noise_over_sigma", "stripe_noise_over_sigma", "corners_rejected", "corners", "stripe_points")
    found |= {key: quality.get(key) for key in (*kept, "stripe_rms_px", "converged")}
    board = quality.get("board") or {}
    found |= {"free": board.get("free"), "held_out_own_px": board.get("held_out_rms_px")}
    halves = version.run(str(HALVES), str(output), str(output.with_name(f"{output.stem}_half")))
    found["halves_seconds"] = halves[3]
    if halves[0]:
        found["halves_error"] = (halves[2].strip().splitlines() or [""])[-1]
    whole = read_solved(output, Pictures(capture))
    if whole is not None:
        names = [output.with_name(f"{output.stem}_half.{which}.json") for which in ("even", "odd")]
        parts = None if halves[0] else [read_solved(name, Pictures(capture)) for name in names]
        found |= board_figures(whole, parts)  # type: ignore[arg-type]
    return found


def read_solved(path: Path, pictures: Pictures) -> Solved | None:
    """A calibration file of jaxscan for NumPy and OpenCV; None where OpenCV lacks its lens."""
    tables = json.loads(path.read_text())
    camera = tables["camera"]
    if camera["model"] not in ("pinhole", "fisheye"):
        return None
    matrix = np.array(
        [[camera["fx"], camera.get("skew", 0.0), camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]]
    )
    lens = camera["distortion"]
    names = ("k1", "k2", "k3", "k4") if camera["model"] == "fisheye" else ORDER
    values = np.array([lens.get(name) or 0.0 for name in names])
    if camera["model"] == "pinhole" and not values[5:].any():
        values = values[:5]
    with np.load(path.with_suffix(".npz")) as arrays:
        kept = {key: arrays[key] for key in arrays.files}
    q = np.where(kept["corners.valid"][..., None], kept["corners.q"], np.nan)
    lines = [
        BoardLine(kept["stripes.q"][k][kept["stripes.valid"][k]], int(view), int(laser))
        for k, (view, laser) in enumerate(zip(kept["stripes.view"], kept["stripes.laser"], strict=True))
    ]
    sheets = [Plane(np.array(one["normal"]), float(one["distance_m"])) for one in tables.get("lasers", [])]
    shape = board_shape(tables, pictures)
    return Solved(Lens(matrix, values, camera["model"] == "fisheye"), shape, list(q), lines, sheets)


def board_shape(tables: dict[str, Any], pictures: Pictures) -> np.ndarray:
    """Corners of the board as calibrated [n, 3]; m. A flat board where the file says nothing else."""
    flat, found = grid(pictures.header["board"]), tables["quality"].get("board") or {}
    if "height_m" not in found:
        return flat
    return flat + np.column_stack([np.array(found["shift_m"]), np.array(found["height_m"])])
