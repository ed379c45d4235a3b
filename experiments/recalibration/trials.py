"""Recalibration against known truths: runs trials, keeps their figures, and judges them.

    python -m experiments.recalibration.trials run KIND … [--seeds FIRST LAST] [--worlds FOLDER]
    python -m experiments.recalibration.trials judge
    python -m experiments.recalibration.trials picture [SEED]

run: one file for each kind, in experiments/results/recalibration. A trial that is kept is not run again, so a run may
be stopped and continued. All trials of a kind take some minutes on two cores, and compile first;
`JAX_COMPILATION_CACHE_DIR` keeps what is compiled for the next kind.

judge: writes experiments/results/recalibration.md. The limits are in `limits.py`; they and the final seeds were written
down before any trial was run. The exit code is 1 where a limit is missed or a trial is not there.

picture: how far the walls of a room are from flat before and after a recalibration, docs/recalibration.png. The laser
of the rig of `configs/paper.toml` is turned by 0.05 degrees after a good calibration.
"""

import argparse
import json
import os
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.recalibration.kinds import KINDS, simulated
from experiments.recalibration.limits import FINAL_SEEDS, LIMITS, TRIALS, Limit, Trials
from experiments.recalibration.trial import run
from experiments.report import RESULTS, ROOT, command_line, rms, table
from jaxscan.report.recalibration import drift_words, plots


TRIALS_FOLDER, PICTURE = RESULTS / "recalibration", ROOT / "docs" / "recalibration.png"


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


HEAD = """# Recalibration from ordinary sweeps, against a known truth

Made by `python -m experiments.recalibration.trials judge` from the trials beside it; a row's trials are run by
`python -m experiments.recalibration.trials run "KIND"` (with `--worlds FOLDER` for rendered worlds). Limits and seeds
({first} to {last}) were written down before any of them was run: `experiments/recalibration/limits.py`.

- Rig and room are those of `configs/paper.toml` and `configs/unkind.toml`; gain and harmonics of the table and the
  ratio of the focal lengths are drawn from their priors in every trial, and so are the boards' poses.
- A paper-like calibration has 23 views, 4 of them lit, and one pair of views 10 degrees apart; a good one 30 lit views
  and 4 boards at 9 angles each. Corners have 0.1 px of noise, stripes on boards 0.15 px.
- Stripes of sweeps are exact, with 0.1 px of noise that 7 neighbouring lines share. "Unkind" has 0.08 px that 9 lines
  share, and unstated a correlation of 0.2 between neighbouring profiles, a pull of 0.05 px in corners of the room and
  0.1 % of strays: somewhat worse than stripes of rendered sweeps are.
- "Features" adds 150 points of the walls, seen in 90 laser-off images with 0.15 px of noise.
- "Stops": the table stops anywhere within a microstep of 28,800 a turn, at the boards and in the room.
- "Rendered unkind" are ten rendered sweeps of `configs/unkind.toml`, each with several paper-like calibrations.
- A trial is run once and kept: most rows have fewer trials than were planned. The first one to three of every row
  were run with one state of the code; later ones of the larger rows are older, from before stops were learned, which
  changes next to nothing where stops are exact. Rendered rooms were not run again.
- Two limits for path-traced rooms were written down as well. These rooms were never run, and the limits are dropped.
- A curved wall (10 mm over the wall) asks for other angles of the table, and the update is refused. Of a wall with a
  step of 10 mm one trial is refused so too; the other one is right.
- Axis shifted since a recalibration (seed 201): whatever its direction, a shift of 0.2 mm across the axis adds 3 to 6
  to a chi-squared of 14 numbers, and 20 would be needed; the stored axis is known to 0.13 and 0.07 mm.
- Two stations: with the true rig and the true pose the walls of seeds 201 to 203 already lie up to 0.16, 0.18 and
  0.41 mm apart, by the noise of the points through which their planes are laid.

"""


def rows(limits: tuple[Limit, ...], trials: dict[str, Trials]) -> tuple[list[list[str]], int]:
    """The table's rows, and how many limits are missed."""
    found, missed = [], 0
    for limit in limits:
        own = [trial for trial in trials[limit.kind] if "problem" not in trial]
        failed = len(trials[limit.kind]) - len(own)
        if not own:
            missed += 1
            reason = f"{failed} trials gave no result" if failed else "not run"
            found.append([limit.kind, limit.name, limit.bounds(), reason, "0", "**no**"])
            continue
        value = limit.figure(own)
        free = limit.low is None and limit.high is None
        good = limit.met(own) and not failed
        verdict = "" if free else "yes" if good else "**no**"
        missed += not good
        count = f"{len(own)}" + (f", {failed} gave no result" if failed else "")
        unit = f" {limit.unit}" if limit.unit else ""
        found.append([limit.kind, limit.name, limit.bounds(), f"{value:.3g}{unit}", count, verdict])
    return found, missed


def spreads(trials: dict[str, Trials]) -> list[list[str]]:
    """Root mean square errors across 180 degrees of each kind, before and after, with the stated sigmas."""
    lines = []
    for kind, every in trials.items():
        own = [trial for trial in every if "problem" not in trial]
        halves = [[one for one in trial["lengths"] if one["name"] == "half a turn"] for trial in own]
        for k in range(min(map(len, halves), default=0)):
            names = ("before", "sigma_before", "after", "sigma_after")
            cells = [f"{rms([half[k][name] for half in halves]):.3g} mm" for name in names]
            metres = np.mean([half[k]["metres"] for half in halves])
            updated = sum(trial["updated"] for trial in own)
            lines.append([kind, f"{metres:.2f} m", *cells, f"{updated} of {len(own)}"])
    return lines


def costs(trials: dict[str, Trials]) -> str:
    """Time and memory of the trials."""
    own = [trial for every in trials.values() for trial in every if "problem" not in trial]
    if not own:
        return ""
    seconds, peak = (np.array([trial[name] for trial in own]) for name in ("seconds", "peak_mb"))
    return (
        f"A recalibration took {np.median(seconds):.0f} s (median of {len(own)} trials); its process held "
        f"{peak.max() / 1000:.1f} GB at most."
    )


def page(trials: dict[str, Trials]) -> tuple[str, int]:
    """The page, and how many limits are missed."""
    judged, missed = rows(LIMITS, trials)
    head = HEAD.format(first=FINAL_SEEDS[0], last=FINAL_SEEDS[-1])
    parts = [
        table(["trials", "figure", "limit", "measured", "number", "met"], judged),
        "Errors of lengths across 180 degrees, root mean squares over the trials:",
        table(["trials", "length", "before", "stated", "after", "stated", "updated"], spreads(trials)),
        costs(trials),
    ]
    return head + "\n\n".join(parts) + "\n", missed


def run_trials(options: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    """Run the trials that are not kept."""
    kinds = dict(KINDS)
    if options.worlds:
        kinds["rendered unkind"] = partial(simulated, folder=options.worlds, kept=options.worlds / "stripes")
    if strange := set(options.kinds) - set(kinds):
        parser.error(f"no such kind: {', '.join(sorted(strange))}; there are {', '.join(kinds)}")
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


def judge(folder: Path) -> int:
    """Write the page; 1 if a limit is missed."""
    text, missed = page({kind: list(kept(folder, kind).values()) for kind in TRIALS})
    output = folder.parent / "recalibration.md"
    output.write_text(text)
    print(f"{output}: {missed} of {len(LIMITS)} limits are missed")
    return int(missed > 0)


def picture(seed: int) -> int:
    """Draw the walls before and after; 1 if there is no recalibration."""
    figures, result = run(KINDS["laser turned"](seed))
    if result is None:
        print(figures["problem"])
        return 1
    plots.panorama_figure(*plots.panorama_rows(result.panoramas[0])).savefig(PICTURE, dpi=90)
    print(drift_words(result.drift))
    return 0


def main() -> int:
    """The command."""
    parser = command_line(__doc__)
    parts = parser.add_subparsers(dest="part", required=True)
    runs = parts.add_parser("run")
    runs.add_argument("kinds", nargs="*", metavar="KIND", help="all, if none is named")
    runs.add_argument("--seeds", nargs=2, type=int, metavar=("FIRST", "LAST"), help="both are run; default: final")
    runs.add_argument("--worlds", type=Path, help="folder of rendered worlds: simulated_101 ...")
    for part in (runs, parts.add_parser("judge")):
        part.add_argument("--results", type=Path, default=TRIALS_FOLDER)
    parts.add_parser("picture").add_argument("seed", type=int, nargs="?", default=1)
    options = parser.parse_args()
    if options.part == "run":
        return run_trials(options, parser)
    return judge(options.results) if options.part == "judge" else picture(options.seed)


if __name__ == "__main__":
    sys.exit(main())
