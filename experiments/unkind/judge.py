"""Judge jaxscan and the plain pipeline on worlds with a known truth: `experiments/results/unkind.md`.

    python -m experiments.unkind.judge FOLDER … [--as before|after] [--results FOLDER]

A FOLDER is one world of `path_traced` or `simulated`; its name ends with its seed (path_traced_101). The figures are
kept in `unkind.json` beside the page, per world, so that a second run adds to them. "before" is measured by the same
program with the sources of an older commit first in PYTHONPATH; runs side by side write to folders of their own, which
`--merge` brings together.
"""

import argparse
import json
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

from experiments.unkind import ours, plain, truth
from experiments.unkind.estimate import Estimate, ray_grid
from experiments.unkind.figures import board_figures, dimension_figures, rig_figures, step_width, sweep_figures
from experiments.unkind.table import markdown


RESULTS = Path(__file__).resolve().parents[1] / "results"


def figures(world: tuple[truth.Truth, truth.TrueStripes, truth.TrueStripes], found: Estimate) -> dict[str, Any]:
    """All figures of an estimate."""
    true, sweep, boards = world
    raw, smooth = step_width(true, sweep, found.rows), step_width(true, sweep, found.smooth)
    return {
        "rig": rig_figures(true, found.rig, ray_grid(true.size)),
        "boards": board_figures(boards, found.boards),
        "promised": board_figures(boards, found.promised),
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
        mine, says = ours.estimate(scratch, world[0])
    return {"ours": figures(world, mine) | {"says": says}, "plain": figures(world, simple)}


def write(folder: Path, results: dict[str, Any]) -> None:
    """Write figures and page."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "unkind.json").write_text(json.dumps(results, indent=1, sort_keys=True) + "\n")
    (folder / "unkind.md").write_text(markdown(results))


def main() -> None:
    """Judge the worlds, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("worlds", type=Path, nargs="*")
    parser.add_argument("--as", dest="which", choices=["before", "after"], default="after")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--merge", type=Path, nargs="*", default=[], help="`unkind.json` of runs beside this one")
    options = parser.parse_args()
    kept = options.results / "unkind.json"
    results: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    for other in options.merge:
        for name, entry in json.loads(other.read_text()).items():
            results.setdefault(name, {}).update(entry)
    for folder in options.worlds:
        start = time.perf_counter()
        measured = judge(folder)
        entry = results.setdefault(folder.name, {})
        entry[options.which] = measured["ours"]
        entry["plain"] = measured["plain"]
        print(f"{folder.name}: {time.perf_counter() - start:.0f} s", flush=True)
        write(options.results, results)
    write(options.results, results)
    print(markdown(results))


if __name__ == "__main__":
    main()
