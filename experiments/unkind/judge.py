"""Judge jaxscan and the plain pipeline on worlds with a known truth: `experiments/results/unkind.md`.

    python -m experiments.unkind.judge FOLDER … [--results FOLDER]

A FOLDER is one world of `path_traced` or `simulated`; its name ends with its seed (path_traced_101). The figures are
kept in `unkind.json` beside the page, per world, so that a second run adds to them.
"""

import json
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from experiments.report import RESULTS, command_line, limits_in_words, number, table
from experiments.unkind import ours, plain, truth
from experiments.unkind.figures import (
    AMPLITUDES,
    CLASSES,
    FINAL_SEEDS,
    LIMITS,
    WALLS_WITHIN_TWO,
    board_figures,
    broken,
    dimension_figures,
    figure,
    rig_figures,
    step_width,
    sweep_figures,
    values,
    worse,
)
from experiments.unkind.truth import Estimate, ray_grid


HEAD = """# Worlds of another renderer

`python -m experiments.unkind.judge WORLD …` writes this page. `path_traced` worlds are rendered by Mitsuba 3,
`simulated` ones by jaxscan's own simulator with `configs/unkind.toml`. "jaxscan" is the code when a world was judged
last; "plain" a blur of 1 px in both directions, a centre of gravity, and sequential calibration by OpenCV. All
figures are against the truth. RMS of stripes of the sweep is over rows on continuous surfaces: no jump, crease or
border of a shadow within 4 px and 2 rows, amplitude under 250 DN; points farther than 5 stated sigmas (1 px where
none are stated) are left out and counted by themselves. "error / stated" is the root mean square of the error
divided by the stated sigma, "stated / true" its inverse.

A path-traced world has a camera of 400 to 480 px, a sheet that is 0.9 px wide (1.2 to 1.4 px with lens and pixel), 8
e-/DN, 1.7 DN of read noise, a black level of 5 DN, and speckle of 5 % on a pixel at f/4. It has 28 views of a board
(8 to 12 columns, 0.8 to 1.7 m away, two placements of six angles) and a sweep of 90 steps in a room of 4 to 4.3 m,
with panels that stand 50 mm out of three walls. The true centre is where the middle of the sheet meets the surface
in the middle of a row, whatever the surface's paint. Tables are turned by angles that err once and twice per turn.
"""
ROWS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("rays [px]", ("rig", "rays_px"), "{:.3f}"),
    ("axis direction [deg]", ("rig", "axis_deg"), "{:.4f}"),
    ("axis point [mm]", ("rig", "axis_mm"), "{:.2f}"),
    ("laser plane at 2.5 m: disparity [px]", ("rig", "sheet_px"), "{:.3f}"),
    ("laser plane at 2.5 m: depth [mm]", ("rig", "sheet_mm"), "{:.2f}"),
    ("points on boards: RMS [px]", ("boards", "rms_px"), "{:.3f}"),
    ("points on boards: stated [px]", ("boards", "stated_px"), "{:.3f}"),
    ("points on boards: error / stated", ("boards", "error_over_stated"), "{:.2f}"),
    *(
        (f"points on boards, print {name}: {title}", ("boards", "classes", name, key), form)
        for title, key, form in (("error / stated", "error_over_stated", "{:.2f}"), ("RMS [px]", "rms_px", "{:.3f}"))
        for name in CLASSES
    ),
    ("points on boards", ("boards", "points"), "{:.0f}"),
    ("largest mean of a view [px]", ("boards", "mean_of_view_px"), "{:.3f}"),
    ("sweep, row-wise: RMS [px]", ("rows", "rms_px"), "{:.4f}"),
    ("sweep, row-wise: RMS / bound", ("rows", "over_bound"), "{:.3f}"),
    ("sweep, row-wise: stated / true", ("rows", "stated_over_true"), "{:.2f}"),
    ("sweep: RMS [px]", ("smooth", "rms_px"), "{:.4f}"),
    ("sweep: RMS / row-wise bound", ("smooth", "over_bound"), "{:.3f}"),
    ("sweep: stated / true", ("smooth", "stated_over_true"), "{:.2f}"),
    *(
        (f"sweep, {low}–{high} DN: {title}", ("smooth", "classes", f"{low}-{high}", key), form)
        for title, key, form in (("stated / true", "stated_over_true", "{:.2f}"), ("RMS [px]", "rms_px", "{:.3f}"))
        for low, high in AMPLITUDES
    ),
    ("rows found of those over 5 sigmas [%]", ("smooth", "found_share"), "{:.2%}"),
    ("farther than 5 sigmas, not at edges [%]", ("smooth", "far_share"), "{:.3%}"),
    ("step of 50 mm, 10–90 %: row-wise [rows]", ("step", "rows"), "{:.2f}"),
    ("step of 50 mm, 10–90 %: as reconstructed [rows]", ("step", "smooth"), "{:.2f}"),
    ("walls: RMS error [mm]", ("walls", "rms_mm"), "{:.2f}"),
    ("calibrate, processor, compiling too [s]", ("seconds", "calibrate_cpu"), "{:.0f}"),
    ("sweep, processor, compiling too [s]", ("seconds", "sweep_cpu"), "{:.0f}"),
)
METHODS = {"ours": "jaxscan", "plain": "plain"}


def seed_of(name: str) -> int:
    """The seed at the end of a world's name."""
    return int(name.rpartition("_")[2])


def markdown(results: dict[str, Any]) -> str:
    """The page."""
    parts = [HEAD, limits_text()]
    kinds = sorted({name.rpartition("_")[0] for name in results})
    for kind in kinds:
        for title, final in (("final seeds", True), ("seeds used while building", False)):
            names = [name for name in results if name.rpartition("_")[0] == kind]
            names = sorted((n for n in names if (seed_of(n) in FINAL_SEEDS) == final), key=seed_of)
            if names:
                chosen = {name: results[name] for name in names}
                parts += [f"## {kind}: {title}", in_all(chosen), verdict(chosen)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def limits_text() -> str:
    """The limits as they were set."""
    lines = []
    for limit in LIMITS:
        bounds = limits_in_words(limit.low, limit.high)
        lines.append(f"- {limit.name}{', in every class' if limit.classes else ''}: {bounds}")
    walls = f"- walls: at least {WALLS_WITHIN_TWO:.0%} of all dimensions within two stated sigmas"
    first, last = FINAL_SEEDS[0], FINAL_SEEDS[-1]
    seeds = f"Final seeds: {first} to {last}; they and these limits were set before any of them was judged."
    return "\n".join(["## Limits", seeds, "", *lines, walls, "- in no seed worse than the plain pipeline"])


def in_all(results: dict[str, Any]) -> str:
    """Range and median over seeds, for every method."""
    known = [which for which in METHODS if any(which in entry for entry in results.values())]
    body = []
    for title, path, form in ROWS:
        cells = [title]
        for which in known:
            each = [figure(entry[which], path) for entry in results.values() if which in entry]
            each = [value for value in each if value is not None and np.isfinite(value)]
            if not each:
                cells.append("–")
            elif len(each) == 1:
                cells.append(number(each[0], form))
            else:
                middle, low, high = (number(value, form) for value in (np.median(each), min(each), max(each)))
                cells.append(f"**{middle}** ({low} … {high})")
        body.append(cells)
    body.append(["walls within two stated sigmas", *(_walls(results, which) for which in known)])
    return table(["median (range over seeds)", *(METHODS[which] for which in known)], body)


def _walls(results: dict[str, Any], which: str) -> str:
    errors, sigmas = (
        np.concatenate([entry[which]["walls"][key] for entry in results.values() if which in entry])
        for key in ("errors_mm", "sigmas_mm")
    )
    if not np.isfinite(sigmas).any():
        return "–"
    missed = sum(entry[which]["walls"]["missed"] for entry in results.values() if which in entry)
    return f"{int((np.abs(errors) <= 2 * sigmas).sum())} of {len(errors) + missed}"


def verdict(results: dict[str, Any]) -> str:
    """Each limit, and the seeds that break it."""
    body = []
    for limit in LIMITS:
        bad = {seed_of(name): broken(entry["ours"], limit) for name, entry in results.items()}
        which = "; ".join(f"seed {seed}: {', '.join(found)}" for seed, found in bad.items() if found)
        every = [value for entry in results.values() for value in values(entry["ours"], limit).values()]
        span = f"{min(every):.3g} … {max(every):.3g}" if every else "–"
        body.append([limit.name, span, "kept" if not which and every else which or "not known"])
    beaten = {seed_of(name): worse(entry["ours"], entry["plain"]) for name, entry in results.items()}
    which = "; ".join(f"seed {seed}: {', '.join(found)}" for seed, found in beaten.items() if found)
    body.append(["never worse than plain", "", which or "kept"])
    body.append(["walls within two stated sigmas", _walls(results, "ours"), ""])
    return table(["limit", "range", "broken by"], body)


def figures(world: tuple[truth.Truth, truth.TrueStripes, truth.TrueStripes], found: Estimate) -> dict[str, Any]:
    """All figures of an estimate."""
    true, sweep, boards = world
    raw, smooth = step_width(true, sweep, found.rows), step_width(true, sweep, found.smooth)
    return {
        "rig": rig_figures(true, found.rig, ray_grid(true.size)),
        "boards": board_figures(boards, found.boards),
        "observed": board_figures(boards, found.observed),
        "rows": sweep_figures(true, sweep, found.rows),
        "smooth": sweep_figures(true, sweep, found.smooth),
        "step": {"rows": raw["rows"], "smooth": smooth["rows"], "profiles": raw["profiles"]},
        "walls": dimension_figures(found.dimensions, len(true.dimensions)),
        "seconds": found.seconds,
    }


def judge(folder: Path) -> dict[str, Any]:
    """One world by jaxscan and by the plain pipeline."""
    world = truth.load(folder / "truth.npz")
    with tempfile.TemporaryDirectory() as scratch:
        # Neither method sees the truth, and nothing is left in the captures.
        for name in ("boards", "sweep"):
            shutil.copytree(folder / name, Path(scratch) / name, ignore=shutil.ignore_patterns("stripes.npz"))
        simple = plain.estimate(scratch, world[0], world[1])
        mine = ours.estimate(scratch, world[0])
    return {"ours": figures(world, mine), "plain": figures(world, simple)}


def main() -> None:
    """Judge the worlds, and write the page."""
    parser = command_line(__doc__)
    parser.add_argument("worlds", type=Path, nargs="*")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    kept = options.results / "unkind.json"
    results: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    for folder in options.worlds:
        start = time.perf_counter()
        results[folder.name] = judge(folder)
        print(f"{folder.name}: {time.perf_counter() - start:.0f} s", flush=True)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(results, indent=1, sort_keys=True) + "\n")
    (options.results / "unkind.md").write_text(markdown(results))


if __name__ == "__main__":
    main()
