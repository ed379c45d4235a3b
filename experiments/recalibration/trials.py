"""Runs trials of recalibration and keeps their figures, one file for each kind.

    python -m experiments.recalibration.trials KIND … [--seeds FIRST LAST] [--results FOLDER] [--worlds FOLDER]

A trial that is kept is not run again, so a run may be stopped and continued. `experiments.recalibration.table` judges
them. The limits are in `limits.py`; they and the final seeds were written down before any was run.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any

from experiments.recalibration.kinds import KINDS, rendered_kinds
from experiments.recalibration.limits import FINAL_SEEDS, TRIALS
from experiments.recalibration.trial import run
from experiments.report import command_line


RESULTS = Path(__file__).resolve().parents[1] / "results" / "recalibration"


def path_of(folder: Path, kind: str) -> Path:
    """The file of a kind."""
    return folder / (kind.replace(",", "").replace(" ", "_") + ".json")


def kept(folder: Path, kind: str) -> dict[str, Any]:
    """The figures of the trials that were run, by seed."""
    path = path_of(folder, kind)
    return json.loads(path.read_text()) if path.exists() else {}


def keep(folder: Path, kind: str, figures: dict[str, Any]) -> None:
    """Write the figures of a kind; a reader never sees half a file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = path_of(folder, kind)
    part = path.with_suffix(".part")
    part.write_text("{\n" + ",\n".join(f'"{seed}": {json.dumps(one)}' for seed, one in figures.items()) + "\n}\n")
    os.replace(part, path)


def line(figures: dict[str, Any]) -> str:
    """A trial in one line."""
    if "problem" in figures:
        return figures["problem"]
    halves = [length for length in figures["lengths"] if length["name"] == "half a turn"]
    parts = [
        f"{length['metres']:.1f} m: {length['before']:+.2f} ({length['sigma_before']:.2f}) -> "
        f"{length['after']:+.3f} ({length['sigma_after']:.3f}) mm"
        for length in halves
    ]
    parts += [f"p {figures['drift']['p']:.2g} {figures['drift']['part']}", figures["refused"]]
    parts += [*figures["table"]["sentences"], f"{figures['seconds']:.0f} s"]
    return "; ".join(part for part in parts if part)


def main() -> int:
    """The command."""
    parser = command_line(__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    parser.add_argument("--seeds", nargs=2, type=int, metavar=("FIRST", "LAST"), help="both are run; default: final")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--worlds", type=Path, help="folder of rendered worlds: simulated_101 ..., path_traced_1 ...")
    parser.add_argument("--list", action="store_true", help="print the kinds")
    options = parser.parse_args()
    kinds = KINDS | (rendered_kinds(options.worlds, options.worlds / "stripes") if options.worlds else {})
    strange = set(options.kinds) - set(kinds)
    if options.list or strange:
        print("\n".join([*(f"unknown: {kind}" for kind in sorted(strange)), *kinds]))
        return int(bool(strange))
    for kind in options.kinds or kinds:
        seeds = range(options.seeds[0], options.seeds[1] + 1) if options.seeds else FINAL_SEEDS[: TRIALS[kind]]
        done = kept(options.results, kind)
        for seed in seeds:
            if str(seed) in done:
                continue
            figures, _ = run(kinds[kind](seed))
            done[str(seed)] = figures
            keep(options.results, kind, done)
            print(f"{kind}, seed {seed}: {line(figures)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
